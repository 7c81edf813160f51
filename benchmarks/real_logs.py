"""Recorded logs of the benchmark `real`: the estimator on each, and its scores."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import karto
from benchmarks.common import Figures, estimate, is_installed
from benchmarks.real_maps import MapData
from mecp_env.core.se2 import composed
from mecp_env.evaluation.calibration import calibrate_log
from mecp_env.evaluation.log_run import LogRun, LogRunConfig, config_for, run_log
from mecp_env.evaluation.trajectory import align
from mecp_env.logs import read_log
from mecp_env.slam.messages import Cell


@dataclass(frozen=True, slots=True)
class LogSet:
    """How a log is run: raw odometry as `mecp-env slam` does without an option, by a calibration from its own scans."""

    runs: int = 1
    run: LogRunConfig = field(default_factory=LogRunConfig)
    calibrated: bool = False


LOGS: dict[str, LogSet] = {
    "fr079": LogSet(5, LogRunConfig(odometry="reference")),
    "intel_raw": LogSet(calibrated=True),
    "csail_raw": LogSet(calibrated=True),
}
ERRORS = ("relations_m", "relations_deg", "relations_at_scans_m", "relations_at_scans_deg", "ate_m", "ate_deg")
FINAL_ERRORS = tuple(f"final_{name}" for name in ERRORS)
COLUMNS = (
    *ERRORS,
    *("dead_reckoning_ate_m", "landmarks", "landmarks_dropped", "rooms", "doors", "polygon_share", "localised_share"),
    *("log_share", "ms_per_scan_median", "ms_per_scan_mean"),
    *(*FINAL_ERRORS, "final_converged", "final_steps", "final_s"),
)
RIVAL = tuple(f"karto_{name}" for name in (*ERRORS, *FINAL_ERRORS, "ms_per_scan_mean", "loops"))


def map_log(folder: Path, name: str, seed: int, scans: int | None = None) -> tuple[Figures, MapData]:
    """Metrics of one run on a log, and its map; only of its first `scans` if given."""
    given, log = LOGS[name], read_log(folder / f"{name}.npz")
    calibration = calibrate_log(log, config_for(log), {}, {}) if given.calibrated else None
    options = given.run.model_copy(update={"seed": seed, "scans": scans})
    run = run_log(log, run=options, calibration=calibration)
    return run.metrics() | rival_of(run), map_of(run)


def rival_of(run: LogRun) -> Figures:
    """Figures of OpenKarto on the same scans and odometry; nothing where it is not installed."""
    if not is_installed(karto.PACKAGE):
        return {}
    rows = np.searchsorted(run.log.t, run.t)
    raw = run.log.T_odom_robot  # without it, odometry was made of the reference path
    odometry = run.T_odom_robot if raw is None else raw[rows]
    return karto.figures(run.log, rows, karto.run(run.log, rows, odometry))


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
    found = {name: [run[name] for run in runs] for name in (*COLUMNS, *RIVAL) if np.isfinite(runs[0].get(name, np.nan))}
    figures = {name: estimate(values) if len(runs) > 1 else values[0] for name, values in found.items()}
    ends = sorted({str(run["ended"]) for run in runs})
    return {**figures, "runs": len(runs), "scans": runs[0]["scans"], "ended": ", ".join(ends)}
