"""The estimator on a log: configuration by the laser, odometry, scans at rest, and what is kept."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mecp_env.core.errors import ConfigError, LogError
from mecp_env.evaluation.log_run import LogDrive, LogRunConfig, config_for, fault_of, run_log
from mecp_env.logs import Log, read_log
from mecp_env.slam.pipeline import SlamPipeline
from tests.logs.files import BEAMS, BEARINGS, drive, write_archive


def log_of(tmp_path: Path, **arrays: object) -> Log:
    return read_log(write_archive(tmp_path / "a.npz", **arrays))


def test_the_estimator_follows_the_log(tmp_path: Path) -> None:
    sensor = config_for(log_of(tmp_path), {"sensor": {"range_sigma_m": 0.07}}).sensor
    assert sensor.field_of_view_deg == pytest.approx(180.0)
    assert (sensor.x_m, sensor.range_sigma_m) == (pytest.approx(0.1), 0.07)
    assert sensor.bearing_sigma_deg == pytest.approx(180.0 / (BEAMS - 1) / np.sqrt(12.0))


def test_run(tmp_path: Path) -> None:
    seen = []
    run = run_log(log_of(tmp_path), after=seen.append)
    metrics = run.metrics()
    assert metrics["ended"] == "complete"
    assert metrics["scans"] == len(seen) == 12
    assert metrics["log_share"] == pytest.approx(1.0)
    assert metrics["ate_m"] < 0.02
    assert metrics["dead_reckoning_ate_m"] < 1e-6
    assert metrics["relations"] == metrics["relations_at_scans"] == 1
    assert metrics["relations_m"] < 0.03
    assert run.counts == {"readings without a return": 1}


def test_noise_on_the_reference_is_that_of_the_seed(tmp_path: Path) -> None:
    log = log_of(tmp_path, odo=None)
    registered = run_log(log)
    assert any("registration" in note for note in registered.notes)
    np.testing.assert_allclose(registered.T_odom_robot, drive()[1], atol=0.02)
    with pytest.raises(LogError, match="no reference path"):
        run_log(log_of(tmp_path, ref=None), run=LogRunConfig(odometry="reference"))
    paths = [run_log(log, run=LogRunConfig(odometry="reference", seed=seed)).T_odom_robot for seed in (1, 1, 2)]
    np.testing.assert_array_equal(paths[0], paths[1])
    assert (paths[0] != paths[2]).any()
    exact = LogRunConfig(odometry="reference", noise={"scale": 0.0})
    np.testing.assert_allclose(run_log(log, run=exact).T_odom_robot, drive()[1], atol=1e-9)


def test_scans_at_rest_are_skipped(tmp_path: Path) -> None:
    poses = drive()[1]
    poses[4:8] = poses[3]
    log = log_of(tmp_path, odo=poses)
    run = run_log(log)
    assert run.counts["scans at rest, skipped"] == 4
    assert len(run.t) == 8
    np.testing.assert_allclose(run.T_odom_robot[-1], poses[-1], atol=1e-9)
    assert len(run_log(log, run=LogRunConfig(rest_m=0.0, rest_deg=0.0)).t) == 12
    assert len(run_log(log, run=LogRunConfig(first=2, scans=3)).t) == 2
    with pytest.raises(ConfigError, match=r"LogRunConfig.noise.*per_metre expected"):
        LogRunConfig(noise={"reading": "per_step"})


@pytest.mark.parametrize(("unsure_from", "said"), [(-1, "recognised since"), (0, "not joined to the earlier map")])
def test_a_run_says_that_it_mapped_on_while_the_pose_was_lost(tmp_path: Path, unsure_from: int, said: str) -> None:
    log = log_of(tmp_path)
    pipeline = SlamPipeline(config_for(log))
    run = LogDrive(log, pipeline, LogRunConfig())
    assert [output.unsure_from for output in run.steps()] == [-1] * 12
    assert run.result().notes == log.notes
    pipeline.guard.resumed, run.output = 1, replace(run.output, unsure_from=unsure_from)
    (note,) = set(run.result().notes) - set(log.notes)
    assert said in note
    assert run.result().metrics()["resumed"] == 1


def test_diverged_lost_to_its_end_few_scans_and_no_corners_are_no_success(tmp_path: Path) -> None:
    run, given = run_log(log_of(tmp_path, scans=60)), LogRunConfig()
    resting = replace(run, log=replace(run.log, found=1000), counts={"scans at rest, skipped": 940})
    for sound in (
        run,
        replace(run, localised=np.arange(60) < 57),
        replace(run, localised=np.arange(60) >= 30),  # not to its end
        replace(run, log=replace(run.log, found=600)),
    ):
        assert fault_of(sound, given) is None
    assert fault_of(resting, LogRunConfig(rest_m=0.5)) is None  # left out on request
    wall = np.where(abs(BEARINGS) < 1.2, 1.0 / np.cos(BEARINGS), np.nan)
    for faulty, said in (
        (replace(run, ended="diverged"), "--noise.scale"),
        (replace(run, localised=np.arange(60) < 50), "lost"),
        (replace(run, localised=np.zeros(60, np.bool_)), "lost"),
        (replace(run, log=replace(run.log, found=601)), "60 of 601"),
        (resting, "--odometry none"),
        (run_log(log_of(tmp_path, ranges=np.tile(wall, (12, 1)))), "no landmark"),
    ):
        assert said in str(fault_of(faulty, given))
