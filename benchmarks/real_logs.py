"""Recorded logs of the benchmark `real`: the estimator on each, and its scores."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import Figures, estimate
from benchmarks.real_maps import MapData
from mecp_env.core.trajectories import composed
from mecp_env.evaluation.log_run import LogRun, LogRunConfig, run_log
from mecp_env.evaluation.trajectory import align
from mecp_env.logs import Log, read_log
from mecp_env.slam.messages import Cell
from mecp_env.world.config import OdometryConfig

PAPER_TURN_DEG = OdometryConfig().turn_sigma_deg


@dataclass(frozen=True, slots=True)
class LogSet:
    """How a log is run. Its figures are those of the laser's path.

    The noise of raw odometry was found from its residuals against the reference, per step between two scans, over the
    square root of the path that the model counts. Intel: 4.1 deg and a bias of -1.8 deg per sqrt(m) in heading,
    together 3.0 times the paper's figure, 0.08 m in distance (0.8 times); CSAIL: 7.8 deg (5.2 times) and 0.06 m. The
    distance noise is left as the paper's. Intel's odometry is that of the robot's centre: the residuals are least
    (0.038 m instead of 0.053 m, medians) where the laser, whose path the reference is, sits 0.08 m ahead of it.
    """

    runs: int = 1
    run: LogRunConfig = field(default_factory=LogRunConfig)
    laser_ahead_m: float = 0.0  # of the robot's centre


LOGS: dict[str, LogSet] = {
    "fr079": LogSet(5, LogRunConfig(odometry="reference")),
    "intel_raw": LogSet(
        run=LogRunConfig(noise=OdometryConfig(turn_sigma_deg=3.0 * PAPER_TURN_DEG)), laser_ahead_m=0.08
    ),
    "csail_raw": LogSet(run=LogRunConfig(noise=OdometryConfig(turn_sigma_deg=5.0 * PAPER_TURN_DEG))),
}
COLUMNS = (
    *("relations_m", "relations_deg", "relations_at_scans_m", "relations_at_scans_deg", "ate_m", "ate_deg"),
    *("dead_reckoning_ate_m", "landmarks", "landmarks_dropped", "rooms", "doors", "polygon_share", "localised_share"),
    *("log_share", "ms_per_scan_median", "ms_per_scan_mean"),
    *("final_relations_m", "final_relations_deg", "final_relations_at_scans_m", "final_relations_at_scans_deg"),
    *("final_ate_m", "final_ate_deg", "final_converged", "final_steps", "final_s"),
)


def map_log(folder: Path, name: str, seed: int, scans: int | None = None) -> tuple[Figures, MapData]:
    """Metrics of one run on a log, and its map; only of its first `scans` if given."""
    given = LOGS[name]
    run = run_log(
        at_laser(read_log(folder / f"{name}.npz"), given.laser_ahead_m),
        run=given.run.model_copy(update={"seed": seed, "scans": scans}),
    )
    return run.metrics(), map_of(run)


def at_laser(log: Log, ahead_m: float) -> Log:
    """The log with the odometry of a laser that sits so far ahead of the robot's centre."""
    if log.T_odom_robot is None or ahead_m == 0.0:
        return log
    return replace(log, T_odom_robot=composed(log.T_odom_robot, np.array([ahead_m, 0.0, 0.0])))


def map_of(run: LogRun) -> MapData:
    """Walls of the grid, both paths, landmarks and doors, in the map frame, all smoothed."""
    grid, path = run.final_output.grid, run.T_final_robot[run.scored]
    rows, columns = np.nonzero(grid.label == int(Cell.OCCUPIED))
    cells = grid.origin + (np.stack([columns, rows], axis=1) + 0.5) * grid.resolution_m
    reference = np.empty((0, 2))
    if run.T_ref_robot is not None:
        T_ref = run.T_ref_robot[run.scored]
        reference = composed(align(path[:, :2], T_ref[:, :2]), T_ref)[:, :2]
    return MapData.of_output(run.final_output, cells=cells, path=path[:, :2], reference=reference)


def summarise(runs: list[dict[str, Any]]) -> Figures:
    """Figures of a log: means over the runs with 95 % intervals, plain numbers of a single run.

    Those of a run that ended early are of the part of the log before; a figure without anything to measure is missing.
    """
    found = {name: [run[name] for run in runs] for name in COLUMNS if np.isfinite(runs[0].get(name, np.nan))}
    figures = {name: estimate(values) if len(runs) > 1 else values[0] for name, values in found.items()}
    ends = sorted({str(run["ended"]) for run in runs})
    return {**figures, "runs": len(runs), "scans": runs[0]["scans"], "ended": ", ".join(ends)}
