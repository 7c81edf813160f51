"""KISS-Matcher as an associator, with the package and with a stand-in."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import kiss, loop, rough_pose
from benchmarks.common import OptionError, is_installed
from benchmarks.drives import Drive
from benchmarks.variants import KISS
from mecp_env.core.se2 import compose, inverse, to_map

ON_PAIRS, ON_POINTS = KISS
ERRORS = np.random.default_rng(3).normal(size=(4, 3))


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


def test_pairs_are_those_that_fit_at_the_pose_found_and_a_page_without_them_says_so(
    monkeypatch: pytest.MonkeyPatch,
    drive: Drive,
    finished: rough_pose.Finished,
) -> None:
    def count(variant: str = ON_PAIRS, errors: np.ndarray = ERRORS, seen: rough_pose.Look | None = None) -> dict:
        associator = loop.VARIANTS.get(variant, KISS[ON_PAIRS]).associator(drive.slam)
        return rough_pose.count_scans(finished, associator, [seen or look] * len(errors), (0.3, 3.0), errors)

    look = rough_pose.look(drive, finished, 100)
    given = stand_in(monkeypatch, look.T_map_robot)
    counts = count()
    assert (counts["right"], counts["wrong"]) == (4, 0)
    corners, landmarks = given
    assert corners.shape == landmarks.shape
    assert len(corners) >= counts["pairs"] / 4
    assert not corners[:, 2].any()

    stand_in(monkeypatch, compose(look.T_map_robot, np.array([3 * kiss.VOXEL_M, 3 * kiss.VOXEL_M, 0.0])))
    assert count()["right"] == 0
    stand_in(monkeypatch, look.T_map_robot, valid=False)
    assert count()["pairs"] == 0
    unasked = stand_in(monkeypatch, look.T_map_robot)  # without two pairs to solve
    far = rough_pose.Look(look.corners, look.polygons, look.true, np.array([500.0, 500.0, 0.0]))
    assert count(errors=np.zeros((1, 3)), seen=far)["pairs"] == 0
    assert not unasked

    monkeypatch.setitem(sys.modules, kiss.PACKAGE, None)
    with pytest.raises(OptionError, match=r"pip install -e '.\[lab\]'"):
        KISS[ON_PAIRS].associator(drive.slam)
    cell = count("mecp")
    without, with_rows = {"mecp": {"s": cell}}, {name: {"s": cell} for name in ("mecp", *KISS)}
    assert "its rows are missing" in loop.report({"paper": loop.summarise([without])})
    assert "its rows are missing" not in loop.report({"paper": loop.summarise([with_rows])})
    assert set(loop.summarise([with_rows, without])) == {"mecp"}


@pytest.mark.skipif(not is_installed(kiss.PACKAGE), reason="extra `lab`")
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
