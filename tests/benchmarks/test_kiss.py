"""KISS-Matcher as an associator, with the package and with a stand-in."""

import dataclasses
import importlib.util
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import kiss, loop, rough_pose
from benchmarks.common import Figures, OptionError
from benchmarks.drives import Drive
from benchmarks.variants import KISS
from mecp_env.core.se2 import compose, inverse, to_map
from tests.benchmarks.test_loop import drive, finished  # noqa: F401  (fixtures)

needs_kiss = pytest.mark.skipif(importlib.util.find_spec(kiss.PACKAGE) is None, reason="extra `lab`")
ON_PAIRS, ON_POINTS = KISS
SIGMA = 0.3, 3.0


def stand_in(monkeypatch: pytest.MonkeyPatch, T: np.ndarray, valid: bool = True) -> list[np.ndarray]:
    """A matcher that answers with a pose that it is told; what it is given."""
    c, s = np.cos(T[2]), np.sin(T[2])
    turn, given = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), list[np.ndarray]()
    solution = SimpleNamespace(valid=valid, rotation=turn, translation=np.array([*T[:2], 0.0]))

    def solve(*clouds: list[np.ndarray]) -> SimpleNamespace:
        given[:] = [np.array(cloud) for cloud in clouds]
        return solution

    matcher = SimpleNamespace(prune_and_solve=solve, reset=lambda: None, reset_solver=lambda: None)
    module = SimpleNamespace(KISSMatcherConfig=lambda **_: None, KISSMatcher=lambda _: matcher)
    monkeypatch.setitem(sys.modules, kiss.PACKAGE, module)
    return given


def count(drive: Drive, finished: rough_pose.Finished, name: str, seen: rough_pose.Look, errors: np.ndarray) -> Figures:  # noqa: F811
    associator = KISS[name].associator(drive.slam)
    return rough_pose.count_scans(finished, associator, [seen] * len(errors), SIGMA, errors)


ERRORS = np.random.default_rng(3).normal(size=(4, 3))


def test_pairs_are_those_that_fit_at_the_pose_found(
    monkeypatch: pytest.MonkeyPatch,
    drive: Drive,  # noqa: F811
    finished: rough_pose.Finished,  # noqa: F811
) -> None:
    seen = rough_pose.look(drive, finished, 100)
    given = stand_in(monkeypatch, seen.T_map_robot)
    counts = count(drive, finished, ON_PAIRS, seen, ERRORS)
    assert (counts["right"], counts["wrong"]) == (4, 0)
    corners, landmarks = given
    assert corners.shape == landmarks.shape
    assert len(corners) >= counts["pairs"] / 4
    assert not corners[:, 2].any()

    beside = compose(seen.T_map_robot, np.array([3 * kiss.VOXEL_M, 3 * kiss.VOXEL_M, 0.0]))
    stand_in(monkeypatch, beside)
    assert count(drive, finished, ON_PAIRS, seen, ERRORS)["right"] == 0
    stand_in(monkeypatch, seen.T_map_robot, valid=False)
    assert count(drive, finished, ON_PAIRS, seen, ERRORS)["pairs"] == 0

    unasked = stand_in(monkeypatch, seen.T_map_robot)  # without two pairs to solve
    far = dataclasses.replace(seen, T_map_robot=np.array([500.0, 500.0, 0.0]))
    assert count(drive, finished, ON_PAIRS, far, np.zeros((1, 3)))["pairs"] == 0
    assert not unasked


def test_a_missing_package_is_named_and_the_page_says_that_its_rows_are_missing(
    monkeypatch: pytest.MonkeyPatch,
    drive: Drive,  # noqa: F811
    finished: rough_pose.Finished,  # noqa: F811
) -> None:
    monkeypatch.setitem(sys.modules, kiss.PACKAGE, None)
    with pytest.raises(OptionError, match=r"pip install -e '.\[lab\]'"):
        KISS[ON_PAIRS].associator(drive.slam)
    looks = [rough_pose.look(drive, finished, 100)] * len(ERRORS)
    cell = rough_pose.count_scans(finished, loop.VARIANTS["mecp"].associator(drive.slam), looks, SIGMA, ERRORS)
    without, with_rows = {"mecp": {"s": cell}}, {name: {"s": cell} for name in ("mecp", *KISS)}
    note = "its rows are missing"
    assert note in loop.report({"paper": loop.summarise([without])})
    assert note not in loop.report({"paper": loop.summarise([with_rows])})
    assert set(loop.summarise([with_rows, without])) == {"mecp"}


@needs_kiss
def test_the_whole_method_finds_how_the_walls_of_a_scan_are_moved(drive: Drive, finished: rough_pose.Finished) -> None:  # noqa: F811
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
