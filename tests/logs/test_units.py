"""Numbers in other units than m, rad and s: an error names them, instead of a map of nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mecp_env.core.errors import LogError
from mecp_env.logs import ReadOptions, read_log
from tests.logs.files import BEARINGS, drive, flaser, write_archive


@pytest.mark.parametrize("step_deg", [5.0, 0.75])
def test_angles_in_degrees(tmp_path: Path, step_deg: float) -> None:
    angles = np.arange(-90.0, 90.1, step_deg)
    path = write_archive(tmp_path / "a.npz", angles=angles, ranges=np.ones((12, len(angles))))
    with pytest.raises(LogError, match=r"are \d+\.\d turns, angles in rad expected"):
        read_log(path)


def test_two_turns_are_one(tmp_path: Path) -> None:
    angles = np.linspace(-np.pi, 3.0 * np.pi, 720, endpoint=False)
    log = read_log(write_archive(tmp_path / "a.npz", angles=angles, ranges=np.ones((12, 720)) + 0.01 * angles))
    assert len(log.bearings) == 360


@pytest.mark.parametrize("per_m", [100.0, 1000.0])
def test_ranges_in_cm_or_mm(tmp_path: Path, per_m: float) -> None:
    ranges = per_m * np.random.default_rng(0).uniform(0.2, 9.0, (12, len(BEARINGS)))
    with pytest.raises(LogError, match=r"half of the readings are beyond \d+ m, at most 100 m expected"):
        read_log(write_archive(tmp_path / "a.npz", ranges=ranges))


@pytest.mark.parametrize("limit", [0.05, 0.012])
def test_no_reading_within_the_limits(tmp_path: Path, limit: float) -> None:
    with pytest.raises(LogError, match="no reading from 0 to"):
        read_log(write_archive(tmp_path / "a.npz", max_range_m=limit))
    with pytest.raises(LogError, match=f"no reading from 0 to {limit:g} m"):
        read_log(write_archive(tmp_path / "a.npz"), ReadOptions(max_range_m=limit))


def test_odometry_in_mm(tmp_path: Path) -> None:
    _, poses, _ = drive()
    poses[:, :2] *= 1000.0
    with pytest.raises(LogError, match=r"odometry: 11 of 11 motions are faster than 5 m/s.*--odometry none"):
        read_log(write_archive(tmp_path / "a.npz", odo=poses))


def test_odometry_without_a_number(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"none of its 12 poses is finite.*--odometry none"):
        read_log(write_archive(tmp_path / "a.npz", odo=np.full((12, 3), np.nan)))


def test_odometry_in_world_coordinates(tmp_path: Path) -> None:
    t, poses, ranges = drive()
    poses[:, :2] += 450_000.0, 5_400_000.0
    (tmp_path / "a.log").write_text("\n".join(flaser(*row) for row in zip(t, poses, ranges, strict=True)))
    np.testing.assert_allclose(read_log(tmp_path / "a.log").T_odom_robot, poses, atol=1e-5)


def test_angles_may_jump_by_a_turn(tmp_path: Path) -> None:
    log = read_log(write_archive(tmp_path / "a.npz", angles=BEARINGS % (2.0 * np.pi)))
    np.testing.assert_allclose(log.bearings, BEARINGS, atol=1e-9)


def test_a_mount_in_degrees_is_none(tmp_path: Path) -> None:
    log = read_log(write_archive(tmp_path / "a.npz", mount=np.array([0.1, 0.0, 180.0])))
    assert log.counts["impossible mounting pose, taken as centred"] == 1
