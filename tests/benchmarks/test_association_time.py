"""The benchmark `association_time`: scans with clutter, and the sums of a race."""

import numpy as np
import pytest

from benchmarks import association_time as benchmark
from benchmarks.drives import Drive
from benchmarks.rough_pose import finish, look
from mecp_env.slam.frontend import front_end
from tests.benchmarks.test_loop import drive  # noqa: F401  (a fixture)


def test_every_associator_decides_on_the_same_scans(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmark, "CORNERS", 8)  # two rooms have no scan of 16 corners
    monkeypatch.setattr(benchmark, "SPURIOUS", 2)
    sums = benchmark.compare(("two_rooms", 0), count=4)
    figures = benchmark.summarise([sums, sums])
    for cells in figures.values():
        assert set(cells) == set(benchmark.METHODS)
        for name, row in cells.items():
            assert row["scans"] == 8
            for key, against in (("ratio", "mecp"), ("ratio_same_corners", benchmark.AGAINST[name])):
                assert row[key]["value"] == pytest.approx(cells[against]["ms"]["value"] / row["ms"]["value"])
            assert row["ratio_with_polygons"]["value"] > row["ratio"]["value"]
            assert row["budget_spent"]["value"] == 0.0  # so few corners need no million nodes
    sharp = figures["0.05 m 0.5 deg"]
    assert sharp["mecp"]["wrong"]["value"] <= 0.05 >= sharp["jcbb with descriptor"]["wrong"]["value"]


def test_spurious_corners_are_in_front_of_what_was_hit_and_vertices_are_kept_first(drive: Drive) -> None:  # noqa: F811
    rng = np.random.default_rng(0)
    plain = front_end(drive.scans[100], drive.slam)
    corners, beams = plain.corners, plain.beams
    kept = np.arange(len(corners))[1:]
    dirty, source = benchmark.with_spurious(corners, beams, kept, rng)
    spurious, real = np.flatnonzero(source < 0), np.flatnonzero(source >= 0)
    assert len(spurious) == benchmark.SPURIOUS
    assert sorted(source[real].tolist()) == kept.tolist()
    for found, before in zip(dirty.measurements(real), corners.measurements(source[real]), strict=True):
        np.testing.assert_array_equal(found, before)
    for i in spurious:
        nearest = np.argmin(np.abs(beams.bearings - dirty.z[i, 1]))
        assert 0.2 * beams.ranges[nearest] <= dirty.z[i, 0] <= 0.9 * beams.ranges[nearest]
    polygons = look(drive, finish(drive), 100).polygons
    first = benchmark.vertices_first(np.arange(100), polygons, rng)
    assert len(first) == len(set(first.tolist())) == benchmark.CORNERS - benchmark.SPURIOUS
    assert set(polygons[0].corners.tolist()) <= set(first.tolist())
