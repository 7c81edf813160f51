"""Recorded drives: the estimator that replays a drive gives the results of the environment's estimator."""

import numpy as np

from benchmarks.drives import RecordingEnv, replay
from mecp_env.slam.pipeline import SlamPipeline
from tests.slam.drives import fed


def test_a_replay_is_the_run_again_to_the_bit() -> None:
    """Seen: each step was recorded twice, and nearest and mecp looked equally bad."""
    env = RecordingEnv(layout="two_rooms", start="random")
    env.reset(seed=4)
    for step in range(25):
        env.step(np.array([0.5, 0.4 * (step % 3 - 1)], np.float32))
    drive, last = env.drive, env.slam_output
    assert len(drive.scans) == len(drive.odometry) == len(drive.T_world_robot) == last.step == 28
    assert [odometry is None for odometry in drive.odometry] == [True] * 3 + [False] * 25
    *_, output = fed(SlamPipeline(drive.slam), drive)
    assert np.array_equal(output.belief.T_map_robot, last.belief.T_map_robot)
    assert np.array_equal(output.belief.p_map, last.belief.p_map)
    assert np.array_equal(output.grid.label, last.grid.label)
    assert replay(drive, drive.slam).error_m[-1] < 0.05
