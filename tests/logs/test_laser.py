"""What a laser's readings mean, whether it is mounted as the log says, and odometry made of its scans."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mecp_env.core.errors import LogError
from mecp_env.core.se2 import between
from mecp_env.evaluation.log_run import config_for
from mecp_env.evaluation.trajectory import trajectory_error
from mecp_env.logs import Log, ReadOptions, read_log
from mecp_env.logs.laser_check import laser_fault
from mecp_env.logs.lasers import no_return_of
from mecp_env.logs.registration import registered, registered_path
from tests.logs.files import drive, lines_of, read_lines, write_archive
from tests.logs.simulated import write_simulated


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_simulated(tmp_path_factory.mktemp("logs") / "rooms.npz")


def with_ranges(folder: Path, ranges: np.ndarray, **more: float) -> Log:
    return read_log(write_archive(folder / "a.npz", ranges=ranges, **more))


@pytest.mark.parametrize("code", [8.183, 32.767, 51.06, 51.15, 81.83])
def test_codes_are_no_hits(tmp_path: Path, code: float) -> None:
    rng = np.random.default_rng(0)
    ranges = rng.uniform(1.0, 7.5, (12, 37))
    lost = rng.random(ranges.shape) < 0.1
    ranges[lost] = code
    assert (np.isnan(with_ranges(tmp_path, ranges).ranges) == lost).all()
    ranges[lost] = np.where(rng.random(lost.sum()) < 0.5, code, code - 0.09)  # devices have several codes
    assert (np.isnan(with_ranges(tmp_path, ranges, max_range_m=100.0).ranges) == lost).all()


def test_far_walls_are_no_codes_but_readings_below_2_cm_are(tmp_path: Path) -> None:
    ranges = np.round(np.random.default_rng(0).uniform(1.0, 7.5, (12, 37)), 2)
    assert np.isfinite(with_ranges(tmp_path, ranges).ranges).all()
    ranges[:, ::5] = 0.006
    assert np.isnan(with_ranges(tmp_path, ranges).ranges[:, ::5]).all()


def test_a_weak_laser_is_learnt_from_beams_between_hits(tmp_path: Path) -> None:
    rng, room, step = np.random.default_rng(0), np.full((50, 360), 3.0), np.radians(1.0)
    hall = room.copy()
    hall[:, :200] = np.nan  # nothing is within the range on one side
    hall[:, 200:] = 5.2
    for ranges, meaning in (
        (room, "free"),
        (np.where(rng.random(room.shape) < 0.4, np.nan, room), "unknown"),
        (hall, "free"),
        (np.where(rng.random(room.shape) < 0.05, np.nan, room), "free"),
    ):
        assert no_return_of(ranges, step, 5.6) == meaning
    every_other = np.full((12, 37), 3.0)
    every_other[:, ::2] = np.nan
    assert with_ranges(tmp_path, every_other, max_range_m=5.6).sensor()["no_return"] == "unknown"  # for the estimator
    assert read_log(write_archive(tmp_path / "b.npz")).sensor()["no_return"] == "free"


@pytest.mark.parametrize("lost", [0.0, 0.05, 0.3])
def test_the_share_of_beams_that_walls_swallow_is_learnt(path: Path, lost: float) -> None:
    """By it the estimator knows which gaps in walls are none."""
    log = read_log(path)
    swallowed = np.random.default_rng(0).random(log.ranges.shape) < lost
    found = replace(log, ranges=np.where(swallowed, np.nan, log.ranges)).sensor()["dark_dropout"]
    assert found == pytest.approx(lost, abs=0.01)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"mirror": True}, "--mirror"),
        ({"laser_yaw_deg": 180.0}, "--laser-yaw-deg 180"),
        ({"laser_yaw_deg": 90.0}, "--laser-yaw-deg -"),
        ({"mirror": True, "laser_yaw_deg": 180.0}, "--mirror --laser-yaw-deg"),
    ],
)
def test_a_laser_that_is_not_mounted_as_the_log_says(path: Path, wrong: dict[str, object], said: str) -> None:
    assert said in str(laser_fault(read_log(path, ReadOptions(**wrong))))


def test_units_that_differ_between_scans_and_odometry(path: Path) -> None:
    log = read_log(path)
    feet = replace(log, ranges=log.ranges / 0.3048, max_range_m=log.max_range_m / 0.3048)
    assert "3.31 times as far by its scans" in str(laser_fault(feet))
    assert laser_fault(feet, distance_scale=1.0 / 0.3048) is None
    ticks = replace(log, T_odom_robot=log.T_odom_robot * (0.05, 0.05, 1.0))
    assert "--noise" not in str(laser_fault(ticks))


def test_a_field_of_view_that_the_log_does_not_say(path: Path, tmp_path: Path) -> None:
    """A laser that sees all around, read as one of half a turn: scans turn by half of what the odometry does."""
    log = read_log(path)
    narrow = replace(log, bearings=0.5 * log.bearings)
    assert "--field-of-view-deg 360" in str(laser_fault(replace(narrow, view_assumed=True)))
    assert "--field-of-view-deg" not in str(laser_fault(narrow))
    t, poses, ranges = drive()
    assert read_lines(tmp_path, lines_of(t, poses, ranges)).view_assumed


def test_beams_that_are_too_far_apart_for_corners(tmp_path: Path) -> None:
    archive = {"t": np.arange(9.0), "ranges": np.full((9, 16), 2.0), "angles": 2.0 * np.pi / 16 * np.arange(16)}
    np.savez(tmp_path / "a.npz", **archive)
    with pytest.raises(LogError, match=r"16 beams 22.5 deg apart.* at most 17"):
        config_for(read_log(tmp_path / "a.npz"))


def test_a_sound_laser_has_no_fault_and_its_scans_give_odometry(path: Path) -> None:
    assert laser_fault(read_log(path)) is None
    log = read_log(path, ReadOptions(use_odometry=False))
    assert log.T_odom_robot is None
    assert laser_fault(log) is None
    made = registered(log)
    blind = replace(
        log, t=np.array([5.0, 5.5, 7.0]), ranges=np.stack((log.ranges[9], log.ranges[12], 0.0 * log.ranges[0] + np.nan))
    )
    first, moved, guessed = registered_path(blind)
    assert between(moved, guessed) == pytest.approx(3.0 * between(first, moved))
    assert trajectory_error(made.T_odom_robot, made.T_ref_robot).rmse_m < 0.1
