"""KISS-Matcher as an associator, and what is said where it is not installed."""

import sys

import numpy as np
import pytest

from benchmarks import kiss, loop, rough_pose
from benchmarks.common import OptionError, is_installed
from benchmarks.drives import Drive
from benchmarks.variants import KISS
from mecp_env.core.se2 import compose, inverse, to_map

ON_PAIRS, ON_POINTS = KISS
needs_kiss = pytest.mark.skipif(not is_installed(kiss.PACKAGE), reason="extra `lab`")


@needs_kiss
def test_pairs_are_those_that_fit_at_the_pose_found(drive: Drive, finished: rough_pose.Finished) -> None:
    here, errors = rough_pose.look(drive, finished, 100), np.random.default_rng(3).normal(size=(4, 3))
    far = rough_pose.Look(here.corners, here.polygons, here.true, np.array([500.0, 500.0, 0.0]))  # no pairs to solve
    associator = KISS[ON_PAIRS].associator(drive.slam)
    counts = rough_pose.count_scans(finished, associator, [here] * 4, (0.3, 3.0), errors)
    assert (counts["right"], counts["wrong"]) == (4, 0)
    assert rough_pose.count_scans(finished, associator, [far], (0.3, 3.0), np.zeros((1, 3)))["pairs"] == 0


def test_a_missing_package_is_named_and_a_page_without_its_rows_says_so(
    drive: Drive, finished: rough_pose.Finished, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, kiss.PACKAGE, None)
    with pytest.raises(OptionError, match=r"pip install -e '.\[lab\]'"):
        KISS[ON_PAIRS].associator(drive.slam)
    seen, mecp = rough_pose.look(drive, finished, 100), loop.VARIANTS["mecp"].associator(drive.slam)
    cell = rough_pose.count_scans(finished, mecp, [seen], (0.3, 3.0), np.zeros((1, 3)))
    without, with_rows = {"mecp": {"s": cell}}, {name: {"s": cell} for name in ("mecp", *KISS)}
    assert "its rows are missing" in loop.report({"paper": loop.summarise([without])})
    assert "its rows are missing" not in loop.report({"paper": loop.summarise([with_rows])})
    assert set(loop.summarise([with_rows, without])) == {"mecp"}


@needs_kiss
def test_the_whole_method_finds_how_the_walls_of_a_scan_are_moved(drive: Drive, finished: rough_pose.Finished) -> None:
    seen, T = rough_pose.look(drive, finished, 100), np.array([0.4, -0.3, 0.2])
    associator = KISS[ON_POINTS].associator(drive.slam)
    assert isinstance(associator, kiss.KissPointsAssociator)
    assert seen.beams is not None
    associator.look_at(seen.beams, finished.pipeline.grid.canvas.grid)
    predicted = finished.pipeline.filter.belief()
    associator.p_map = to_map(compose(predicted.T_map_robot, T), associator.p_robot)
    found = associator._pose(np.empty((0, 2)), np.empty((0, 2)), predicted)
    assert found is not None
    assert compose(inverse(predicted.T_map_robot), found) == pytest.approx(T, abs=0.1)
