"""Odometry that stands still, is missing for a while or jumps away and back: scans or neighbours tell the motion."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mecp_env.core.se2 import between
from mecp_env.logs import Log, read_log
from mecp_env.logs.assemble import repeated
from mecp_env.logs.odometry_model import OdometryModel
from mecp_env.logs.registration import bridged, with_ends
from tests.logs.calibrated import simulated_log
from tests.logs.files import BEARINGS, drive

FIRST, LAST = 60, 110


@pytest.fixture(scope="module")
def log() -> Log:
    noise = {"distance_sigma_m": 0.002, "distance_sigma_turning_m": 0.0, "turn_sigma_deg": 0.1}
    return simulated_log(OdometryModel(**noise, turn_sigma_turning_deg=0.0), x_m=0.0, scans=160)


def check_stretch(found: Log, log: Log) -> None:
    """The motion over the stretch is the true one, and the rest is the odometry's."""
    assert any("motions are those of the scans" in note for note in found.notes)
    over = [between(poses[FIRST], poses[LAST]) for poses in (found.T_odom_robot, log.T_ref_robot)]
    np.testing.assert_allclose(over[0], over[1], atol=0.1)
    for rows in (slice(0, FIRST + 1), slice(LAST, None)):
        kept = [between(poses[rows][:1], poses[rows]) for poses in (found.T_odom_robot, log.T_odom_robot)]
        np.testing.assert_allclose(*kept, atol=1e-9)


def test_odometry_that_stands_still_while_the_robot_drives(log: Log) -> None:
    frozen = log.T_odom_robot.copy()
    frozen[FIRST:LAST] = frozen[FIRST]  # and catches up
    check_stretch(bridged(replace(log, T_odom_robot=frozen), log.t), log)


def test_a_laser_that_hangs_while_the_robot_drives(log: Log, tmp_path: Path) -> None:
    """Seen: eight seconds of one scan moved the path by 16 m, and nothing said so."""
    ranges = log.ranges.copy()
    ranges[FIRST : FIRST + 20] = ranges[FIRST]
    arrays = {"t": log.t, "ranges": np.where(np.isfinite(ranges), ranges, np.nan), "angles": log.bearings}
    np.savez(tmp_path / "hangs.npz", odo=log.T_odom_robot, **arrays)
    found = read_log(tmp_path / "hangs.npz")
    left = found.counts["scans that repeat the one before, though the robot moved, left out"]
    assert 15 <= left < 20
    assert len(found) == len(log) - left
    still = np.tile(log.T_odom_robot[FIRST], (len(log), 1))
    assert not repeated(ranges, still).any()


def test_odometry_that_is_missing_for_a_while(log: Log) -> None:
    between_rows = np.arange(FIRST + 1, LAST)
    poses = log.T_odom_robot.copy()
    poses[between_rows, :2] = np.linspace(poses[FIRST, :2], poses[LAST, :2], LAST - FIRST + 1)[1:-1]
    found = bridged(replace(log, T_odom_robot=poses), np.delete(log.t, between_rows))
    check_stretch(found, log)
    off = between(log.T_odom_robot[FIRST], log.T_odom_robot) - between(found.T_odom_robot[FIRST], found.T_odom_robot)
    assert abs(off[FIRST:LAST, :2]).max() < 0.1


def test_odometry_that_begins_late_or_ends_early(log: Log) -> None:
    poses = np.full_like(log.T_odom_robot, np.nan)
    poses[FIRST:LAST] = log.T_odom_robot[FIRST:LAST]
    known = with_ends(log.t, poses, np.isfinite(poses[:, 0]))
    assert known.all()
    found = bridged(replace(log, T_odom_robot=poses), log.t[FIRST:LAST])
    for rows in ((0, FIRST), (LAST, len(log) - 1)):
        np.testing.assert_allclose(
            *(between(p[rows[0]], p[rows[1]]) for p in (found.T_odom_robot, log.T_ref_robot)), atol=0.15
        )
    few = np.isfinite(log.t) & (np.arange(len(log)) > 2)
    assert (with_ends(log.t, log.T_odom_robot.copy(), few) == few).all()


def test_a_robot_at_rest_is_left_at_rest(log: Log) -> None:
    rows = np.concatenate((np.arange(FIRST), np.full(40, FIRST), np.arange(FIRST, 160)))
    noise = np.random.default_rng(0).normal(0.0, 0.02, (len(rows), log.ranges.shape[1]))
    arrays = {name: getattr(log, name)[rows] for name in ("T_odom_robot", "T_ref_robot")}
    resting = replace(log, t=0.4 * np.arange(len(rows)), ranges=log.ranges[rows] + noise, **arrays)
    assert bridged(resting, resting.t) is resting
    assert bridged(log, log.t) is log


@pytest.mark.parametrize("spike", [1e6, -7.0])
def test_single_poses_that_jump_away_and_back(tmp_path: Path, spike: float) -> None:
    t, poses, ranges = drive(30)
    wrong = poses.copy()
    wrong[[7, 20]] += (spike, 0.0, 0.0)
    np.savez(tmp_path / "a.npz", t=t, ranges=ranges, angles=BEARINGS, odo=wrong)
    log = read_log(tmp_path / "a.npz")
    assert log.counts == {"samples of the odometry that jump away and back": 2}
    np.testing.assert_allclose(log.T_odom_robot, poses, atol=1e-3)
