"""The record of a run and the final map: nearer to the truth than the online path, over drives of several seeds."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mecp_env.core.intervals import estimate
from mecp_env.evaluation.log_run import LogDrive, LogRunConfig, config_for, run_log
from mecp_env.logs import Log, read_log
from mecp_env.slam import SlamPipeline, smoothing
from mecp_env.slam.smoothing.optimum import SmoothingError
from tests.logs.simulated import write_simulated
from tests.slam.drives import THROUGH_THE_DOOR

SEEDS = range(4)
ROUND = (*THROUGH_THE_DOOR, *THROUGH_THE_DOOR[-2::-1]) * 2
OPTIONS = LogRunConfig(odometry="reference", noise={"turn_sigma_deg": 4.0})


def log_of(path: Path, seed: int = 0) -> Log:
    """A drive through two rooms, there and back twice, by a laser with a blind side."""
    laser = {"field_of_view_deg": 180.0, "beams": 181, "range_sigma_m": 0.03}
    return read_log(write_simulated(path / f"{seed}.npz", seed, waypoints=ROUND, **laser))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    return log_of(tmp_path_factory.mktemp("logs"))


@pytest.mark.slow
def test_the_final_path_is_better(tmp_path: Path) -> None:
    metrics = [run_log(log_of(tmp_path, s), run=OPTIONS.model_copy(update={"seed": s})).metrics() for s in SEEDS]
    assert all(m["final_converged"] for m in metrics)
    for name in ("ate_m", "ate_deg"):
        shares = estimate([m[f"final_{name}"] / m[name] for m in metrics])
        assert shares["high"] < 1.0  # of the 95 % interval


def test_a_merged_landmark_is_the_one_that_it_became(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    drive = LogDrive(log, SlamPipeline(config_for(log)), OPTIONS)
    list(drive.steps())
    ids, graph = drive.trace.graph()
    assert len(drive.trace.registrations) > 0.8 * len(drive.trace.T_map_laser)
    first, second, last = ids[:3].tolist()
    monkeypatch.setattr(drive.pipeline.map, "merged", {first: second, second: last})
    fewer, merged = drive.trace.graph()
    assert set(ids.tolist()) - set(fewer.tolist()) == {first, second}
    assert len(merged.sightings.z) == len(graph.sightings.z)
    counts = [np.count_nonzero(graph.sightings.landmark == row) for row in range(3)]
    assert np.count_nonzero(merged.sightings.landmark == 0) == sum(counts)


def test_without_an_optimum_the_online_path_is_the_final_one(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise SmoothingError("poses still move")

    monkeypatch.setattr(smoothing, "smooth", fails)
    run = run_log(log, run=OPTIONS.model_copy(update={"scans": 20}))
    assert run.final is None
    np.testing.assert_array_equal(run.T_final_robot, run.T_map_robot)
    assert any("poses still move" in note and "online" in note for note in run.notes)
    assert not run.metrics()["final_converged"]


def test_the_shortest_runs(log: Log) -> None:
    with pytest.raises(SmoothingError, match="no scan"):
        smoothing.Trace(SlamPipeline()).final()
    run = run_log(log, run=OPTIONS.model_copy(update={"scans": 1}))
    assert run.final.T_map_robot.shape == run.T_map_robot.shape
    dark = replace(log, ranges=np.full_like(log.ranges, np.nan))
    run = run_log(dark, run=OPTIONS.model_copy(update={"scans": 10}))
    np.testing.assert_allclose(run.T_final_robot, run.T_map_robot, atol=1e-6)
