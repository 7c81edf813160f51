"""A laser that is not at the robot's centre or does not look all around: the same map, and no corner at its edges."""

import math

import numpy as np
import pytest

from mecp_env.core.se2 import to_map
from mecp_env.core.sensors import LaserView
from mecp_env.slam.checks import SensorError
from mecp_env.slam.config import SensorModel, SlamConfig
from mecp_env.slam.grid.key_scans import free_and_walls
from mecp_env.slam.landmark_map.tracks import PruneLimits, is_seen_through
from mecp_env.slam.pipeline import SlamPipeline
from tests.env.helpers import make
from tests.env.test_goal_actions import explore
from tests.slam.drives import scripted_drive
from tests.slam.scans import PAPER, ROOM, front_end, take_scan

ASIDE, BACKWARDS = {"x_m": -0.1, "y_m": 0.12, "heading_deg": 90.0}, {"heading_deg": 180.0}
TO_CORNERS = 0.1  # m, of a landmark from its true corner


def sensor_of(**view):
    return SlamConfig(sensor=SensorModel(**{name: view[name] for name in LaserView.model_fields if name in view}))


def off_corners(output, drive):
    """Distance (N,) m of each landmark from the nearest true corner."""
    p_world = to_map(drive.T_world_robot[0], np.ascontiguousarray(output.belief.p_map))
    away = p_world[:, None] - drive.outline.corners.p_world[None]
    return np.hypot(away[..., 0], away[..., 1]).min(axis=1)


@pytest.mark.parametrize("view", [ASIDE, BACKWARDS])
def test_a_drive_with_a_mounted_laser_gives_the_right_map_which_is_entered_by_the_pose_of_the_robot(view, tmp_path):
    drive = scripted_drive(seed=3, **view)
    *_, (pipeline, output, _, _) = runs = list(drive.run(sensor_of(**view)))
    assert max(np.hypot(*error[:2]) for *_, error in runs) < 0.06
    assert len(output.belief.ids) >= 8
    assert off_corners(output, drive).max() < TO_CORNERS
    pipeline.save_map(tmp_path / "map")
    believed = output.belief.T_map_robot
    for start, off in (((believed + np.array([0.2, -0.1, 0.1])).tolist(), 0.03), ("saved", 0.01)):
        entered = SlamPipeline.from_map(tmp_path / "map", start=start).start(drive.scans[-1])
        assert entered.belief.T_map_robot == pytest.approx(believed, abs=off)


def test_a_scan_wider_than_the_view_of_the_sensor_is_refused():
    pipeline = SlamPipeline(sensor_of(field_of_view_deg=180.0))
    with pytest.raises(
        SensorError, match=r"scan\.bearings: up to 180 deg, at most 90, half of sensor\.field_of_view_d"
    ):
        pipeline.start(take_scan(ROOM))


def narrow(scan, degrees):
    kept = np.abs(scan.bearings[0]) <= math.radians(degrees / 2.0)
    cut = (np.ascontiguousarray(a[:, kept]) for a in (scan.ranges, scan.bearings, scan.hit))
    return type(scan)(*cut, scan.max_range_m)


@pytest.mark.parametrize("degrees", [270.0, 120.0])
def test_the_blind_side_is_not_painted(degrees):
    beams, _, segments, _ = front_end(narrow(take_scan(ROOM), degrees), PAPER)
    assert beams.blind
    outline, strips = free_and_walls(beams, segments, SlamConfig().grid)
    assert outline[-1].tolist() == [0.0, 0.0]
    edge = math.radians(degrees / 2.0)
    assert np.abs(np.arctan2(outline[:-1, 1], outline[:-1, 0])).max() <= edge + 1e-3
    middles = strips.mean(axis=1)
    assert np.abs(np.arctan2(middles[:, 1], middles[:, 0])).max() < edge
    assert not front_end(take_scan(ROOM), PAPER)[0].blind


def test_no_landmark_is_seen_through_on_the_blind_side():
    limits = PruneLimits.of(SlamConfig())
    bearings = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 361)
    ranges = np.full(361, 6.0)
    for bearing, seen in ((0.0, True), (1.2, True), (1.57, False), (2.0, False), (math.pi, False), (-2.5, False)):
        assert is_seen_through((ranges, bearings, True), 2.0, bearing, 0.0, limits) == seen


@pytest.mark.parametrize("estimator", ["truth", "known"])
def test_the_upper_bounds_know_where_the_laser_is(estimator):
    env = make(actions="goal", estimator=estimator, laser=ASIDE)
    explore(env)
    summary = env.unwrapped.summary()
    if estimator == "known":
        assert summary["association_false"] == summary["duplicates"] == 0
        assert summary["association_recall"] > 0.98  # a corner that is off by more than its noise is left out
    else:
        assert summary["association_false"] <= 2
    assert summary["map_rmse_m"] < 0.03
    assert summary["pose_error_worst_m"] < (1e-6 if estimator == "truth" else 0.05)
