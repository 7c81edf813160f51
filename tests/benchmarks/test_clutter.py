"""The benchmark `clutter`: corners that are missed or invented, the same ones for every associator."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import clutter
from benchmarks.clutter import ClutteredPipeline, cluttered
from benchmarks.drives import Drive, replay
from benchmarks.variants import associating, associators
from mecp_env.core.se2 import polar_to_points
from mecp_env.lab.rivals import NearestAssociator
from mecp_env.slam import config
from mecp_env.slam.association import register_associator
from mecp_env.slam.frontend import front_end
from mecp_env.slam.messages import CornerKind, Corners, MergedScan


@pytest.fixture(scope="module")
def scans(drive: Drive) -> list[tuple[Corners, MergedScan]]:
    found = [front_end(scan, drive.slam) for scan in drive.scans[:63]]
    return [(features.corners, features.beams) for features in found]


def test_no_clutter_is_the_estimator_itself_to_the_bit(drive: Drive) -> None:
    plain = replay(drive, drive.slam)
    changed = replay(
        drive, drive.slam, estimator=lambda slam, **parts: ClutteredPipeline(slam, (1.0, 0.0), seed=0, **parts)
    )
    np.testing.assert_array_equal(plain.nees, changed.nees, strict=True)
    rows = [json.dumps(outcome.counts | {"associate_ms": 0.0}) for outcome in (plain, changed)]
    assert rows[0] == rows[1]


def test_missed_corners_nest_and_their_share_is_as_asked(scans: list[tuple[Corners, MergedScan]]) -> None:
    left = dict.fromkeys(clutter.DETECTION, 0)
    for number, (corners, beams) in enumerate(scans):
        kept = {d: cluttered(corners, beams, d, 0.0, np.random.default_rng(number)).z for d in clutter.DETECTION}
        bearings = {d: set(z[:, 1].tolist()) for d, z in kept.items()}
        assert bearings[0.8] <= bearings[0.9] <= bearings[0.95] <= bearings[1.0]
        left = {d: n + len(kept[d]) for d, n in left.items()}
    for detection, count in left.items():
        assert abs(count / left[1.0] - detection) < 0.05


def test_invented_corners_lie_where_beams_end_away_from_all_others(scans: list[tuple[Corners, MergedScan]]) -> None:
    invented = 0
    for number, (corners, beams) in enumerate(scans):
        found = cluttered(corners, beams, 1.0, 0.3, np.random.default_rng(number))
        assert (np.diff(found.z[:, 1]) >= 0.0).all()
        np.linalg.cholesky(found.cov)
        false = ~np.isin(found.z[:, 1], corners.z[:, 1])
        invented += int(false.sum())
        at = np.searchsorted(beams.bearings, found.z[false, 1])
        np.testing.assert_array_equal(beams.ranges[at], found.z[false, 0])
        assert beams.hit[at].all()
        apart = polar_to_points(found.z[false])[:, None] - polar_to_points(corners.z)
        assert (np.hypot(*np.moveaxis(apart, 2, 0)) > clutter.CLEAR_M).all()
        assert not (found.kind[false] == CornerKind.JAMB).any()
        assert (found.beyond[false] == -1).all()
        alone = np.kron(np.diag(false), np.ones((2, 2))) > 0
        assert not found.cov[np.repeat(false, 2)][~alone[np.repeat(false, 2)]].any()
    assert abs(invented / sum(len(corners) for corners, _ in scans) - 0.3) < 0.05


def test_doors_name_their_jambs_after_corners_are_gone(scans: list[tuple[Corners, MergedScan]]) -> None:
    doors, lost = 0, 0
    for number, (corners, beams) in enumerate(scans):
        found = cluttered(corners, beams, 0.8, 0.3, np.random.default_rng(number))
        pairs = {tuple(pair) for pair in corners.z[corners.doorways.jambs.reshape(-1, 2), 1].tolist()}
        kept = {tuple(pair) for pair in found.z[found.doorways.jambs.reshape(-1, 2), 1].tolist()}
        assert kept <= pairs
        doors, lost = doors + len(kept), lost + len(pairs) - len(kept)
        assert found.beyond.max(initial=-1) < len(found.doorways.width) == len(found.doorways.jambs)
        for i in np.flatnonzero(found.beyond >= 0).tolist():
            before = int(np.flatnonzero(corners.z[:, 1] == found.z[i, 1])[0])
            door, now = corners.doorways.jambs[corners.beyond[before]], found.doorways.jambs[found.beyond[i]]
            assert found.z[now, 1].tolist() == corners.z[door, 1].tolist()
    assert doors
    assert lost
    rng = np.random.default_rng(0)
    assert len(cluttered(corners, beams, 0.0, 0.0, rng)) == 0
    assert len(cluttered(corners, replace(beams, hit=np.zeros_like(beams.hit)), 1.0, 1.0, rng)) == len(corners)


def test_registered_associators_have_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(config.METHODS, "others", [])
    before = associators()
    assert {row.change["association"]["method"] for row in before.values()} == set(config.METHODS.ours)
    register_associator("own_rival", type("Own", (NearestAssociator,), {}))
    assert associators() == before | {"own_rival": associating(method="own_rival")}
