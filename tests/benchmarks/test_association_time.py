"""The benchmark `association_time`: scans with clutter, and the sums of a race."""

import numpy as np
import pytest

from benchmarks import association_time as benchmark
from benchmarks.common import Figures
from benchmarks.drives import Drive
from benchmarks.rough_pose import finish, front_end, look
from tests.benchmarks.test_loop import drive  # noqa: F401  (a fixture)


@pytest.fixture(scope="module")
def figures() -> Figures:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(benchmark, "CORNERS", 8)  # two rooms have no scan of 16 corners
        patch.setattr(benchmark, "SPURIOUS", 2)
        sums = benchmark.compare(("two_rooms", 4, 0))
    return {"two_rooms": benchmark.summarise([sums, sums])}


def test_every_associator_decides_on_the_same_scans(figures: Figures) -> None:
    for cells in figures["two_rooms"].values():
        assert set(cells) == set(benchmark.METHODS)
        for name, row in cells.items():
            assert row["scans"] == 8
            assert row["ms"]["value"] > 0.0
            for key, against in (("ratio", "mecp"), ("ratio_same_corners", benchmark.AGAINST[name])):
                assert row[key]["value"] == pytest.approx(cells[against]["ms"]["value"] / row["ms"]["value"])
            assert row["ratio_with_polygons"]["value"] > row["ratio"]["value"]
            assert row["budget_spent"]["value"] == 0.0  # so few corners need no million nodes
    sharp = figures["two_rooms"]["0.05 m 0.5 deg"]
    assert sharp["mecp"]["wrong"]["value"] <= 0.05 >= sharp["jcbb with descriptor"]["wrong"]["value"]
    assert "## two_rooms (8 scans per row)" in benchmark.report(figures)


def test_spurious_corners_are_independent_in_front_of_what_was_hit_and_vertices_are_kept_first(drive: Drive) -> None:  # noqa: F811
    rng = np.random.default_rng(0)
    corners, beams, _ = front_end(drive.scans[100], drive.slam)
    kept = np.arange(len(corners))[1:]
    dirty, source = benchmark.with_spurious(corners, beams, kept, rng)
    spurious = np.flatnonzero(source < 0)
    assert len(spurious) == benchmark.SPURIOUS
    assert sorted(source[source >= 0].tolist()) == kept.tolist()
    assert (np.diff(dirty.z[:, 1]) >= 0.0).all()
    real = np.flatnonzero(source >= 0)
    z, cov = corners.measurements(source[real])
    np.testing.assert_array_equal(dirty.measurements(real)[0], z)
    np.testing.assert_array_equal(dirty.measurements(real)[1], cov)
    assert not dirty.beyond[spurious].max() >= 0
    assert dirty.sites[spurious].all()
    np.linalg.cholesky(dirty.cov)
    for i in spurious:
        nearest = np.argmin(np.abs(beams.bearings - dirty.z[i, 1]))
        assert 0.2 * beams.ranges[nearest] <= dirty.z[i, 0] <= 0.9 * beams.ranges[nearest]
        others = np.delete(np.arange(2 * len(dirty)), [2 * i, 2 * i + 1])
        assert not dirty.cov[2 * i][others].any()
    polygons = look(drive, finish(drive), 100).polygons
    first = benchmark.vertices_first(np.arange(100), polygons, rng)
    assert len(first) == len(set(first.tolist())) == benchmark.CORNERS - benchmark.SPURIOUS
    assert set(polygons[0].corners.tolist()) <= set(first.tolist())
