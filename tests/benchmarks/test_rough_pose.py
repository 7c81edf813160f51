"""Single scans against a map: `loop`, `association_time` and `map_size`."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import association_time, loop, map_size
from benchmarks.common import Options
from benchmarks.drives import Drive
from benchmarks.rough_pose import RIGHT_PAIRS, Finished, count_scans, look
from benchmarks.tables import report_of
from benchmarks.variants import associators
from mecp_env.core.intervals import estimate
from mecp_env.slam.config import KINDS
from mecp_env.slam.frontend import front_end


def test_two_passes_are_worth_something_at_a_wide_prior_and_nothing_at_a_sharp_one(
    drive: Drive, finished: Finished
) -> None:
    looks = [look(drive, finished, step) for step in range(20, len(drive.scans), 10)]
    errors = np.random.default_rng(0).normal(size=(len(looks), 3))

    def right(variant: str, sigma: tuple[float, float]) -> int:
        associator = loop.VARIANTS[variant].associator(drive.slam)
        return int(count_scans(finished, associator, looks, sigma, errors)["right"])

    assert right("mecp", (0.05, 0.5)) == right("mecp in one pass", (0.05, 0.5))
    assert right("mecp", (1.5, 15.0)) > right("mecp in one pass", (1.5, 15.0))


def test_a_pair_with_another_landmark_is_wrong(drive: Drive, finished: Finished) -> None:
    seen = look(drive, finished, 100)
    associator = loop.VARIANTS["mecp"].associator(drive.slam)
    sigma, exact = (0.05, 0.5), np.zeros((1, 3))
    counts = count_scans(finished, associator, [seen], sigma, exact)
    assert (counts["right"], counts["wrong"]) == (1, 0)
    assert counts["pairs"] >= RIGHT_PAIRS
    spurious = replace(seen, true=np.full_like(seen.true, -1))
    none = count_scans(finished, associator, [spurious], sigma, exact)
    assert (none["right"], none["possible"], none["wrong"]) == (0, 0, counts["pairs"])


def test_every_associator_decides_on_the_same_scans(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(association_time, "CORNERS", 8)  # two rooms have no scan of 16 corners
    monkeypatch.setattr(association_time, "SPURIOUS", 2)
    sums = association_time.compare(("two_rooms", 0), count=4)
    figures = association_time.summarise([sums, sums])
    for cells in figures.values():
        assert set(cells) == set(association_time.METHODS)
        for name, row in cells.items():
            assert row["scans"] == 8
            for key, against in (("ratio", "mecp"), ("ratio_same_corners", association_time.AGAINST[name])):
                assert row[key]["value"] == pytest.approx(cells[against]["ms"]["value"] / row["ms"]["value"])
            assert row["ratio_with_polygons"]["value"] > row["ratio"]["value"]
            assert row["budget_spent"]["value"] == 0.0  # so few corners need no million nodes
    sharp = figures["0.05 m 0.5 deg"]
    assert sharp["mecp"]["wrong"]["value"] <= 0.05 >= sharp["jcbb with descriptor"]["wrong"]["value"]


def test_spurious_corners_are_in_front_of_what_was_hit_and_vertices_are_kept_first(
    drive: Drive, finished: Finished
) -> None:
    rng, plain = np.random.default_rng(0), front_end(drive.scans[100], drive.slam)
    kept = np.arange(len(plain.corners))[1:]
    dirty, source = association_time.with_spurious(plain.corners, plain.beams, kept, rng)
    spurious, real = np.flatnonzero(source < 0), np.flatnonzero(source >= 0)
    assert len(spurious) == association_time.SPURIOUS
    assert sorted(source[real].tolist()) == kept.tolist()
    for found, before in zip(dirty.measurements(real), plain.corners.measurements(source[real]), strict=True):
        np.testing.assert_array_equal(found, before)
    for i in spurious:
        nearest = np.argmin(np.abs(plain.beams.bearings - dirty.z[i, 1]))
        assert 0.2 * plain.beams.ranges[nearest] <= dirty.z[i, 0] <= 0.9 * plain.beams.ranges[nearest]
    polygons = look(drive, finished, 100).polygons
    first = association_time.vertices_first(np.arange(100), polygons, rng)
    assert len(first) == len(set(first.tolist())) == association_time.CORNERS - association_time.SPURIOUS
    assert set(polygons[0].corners.tolist()) <= set(first.tolist())


def test_a_map_of_copies_has_as_many_landmarks_and_its_polygons(drive: Drive) -> None:
    count = 60
    pipeline, number = map_size.enlarged(drive, drive.slam, count)
    first, _ = map_size.enlarged(drive, drive.slam, map_size.FIRST)
    belief, own, polygons = pipeline.filter.belief(), first.filter.belief(), pipeline.map.polygons
    copied = belief.p_map[:, 0] > map_size.APART_M / 2
    assert copied.sum() == len(belief.ids) - len(own.ids)
    assert count <= len(belief.ids) <= max(count, map_size.FIRST + 3) + 1  # several are confirmed in one scan
    np.testing.assert_allclose(belief.p_map[~copied], own.p_map, atol=0.02)
    whole = belief.p_map[copied][: len(own.ids) - 1] - [map_size.APART_M, 0.0]
    np.testing.assert_allclose(whole, own.p_map[: len(whole)], atol=0.05)
    assert len(polygons.polygons) == sum(len(group.index) for group in polygons.groups.values())
    assert len(polygons.polygons) >= len(first.map.polygons.polygons) * (count // len(own.ids))
    assert 0 < number < len(drive.scans) - map_size.SCANS
    with pytest.raises(ValueError, match="landmarks, 25 expected"):
        map_size.enlarged(drive.part(0, 3), drive.slam, 50)


def test_every_registered_part_has_a_row(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(map_size, "in_parallel", lambda task, kind, units, options: [[1.0, 2.0]] * len(units))
    figures = map_size.run(Options(quick=True, folder=tmp_path))
    assert list(figures["filters"]) == [*KINDS.ours, *KINDS.others]
    assert set(figures["associators"]) == set(associators()) - {"known"}
    assert figures["filters"]["ekf"] == {"25": estimate([1.0, 2.0]), "50": estimate([1.0, 2.0])}
    assert "| riekf_submaps |" in report_of(figures)
    assert [axes.get_title() for axes in map_size.figure(figures).axes] == ["filters", "associators"]


@pytest.mark.parametrize(
    ("timed", "name"),
    [(map_size.step_ms, "ekf"), (map_size.association_ms, "mecp"), (map_size.association_ms, "jcbb")],
)
def test_every_part_gives_a_time_per_scan(timed: object, name: str, drive: Drive) -> None:
    ms = timed(drive, name, 50)  # type: ignore[operator]
    assert len(ms) == map_size.SCANS
    assert min(ms) > 0.0
