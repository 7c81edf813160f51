"""Recorded logs of the benchmark `real`: the estimator on each, and its scores."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmarks import karto
from benchmarks.common import Figures, estimate, is_installed, shared_data
from mecp_env.cli.runs import final_view
from mecp_env.evaluation.calibration import Calibration, calibrate_log
from mecp_env.evaluation.log_run import LogRunConfig, config_for, run_log
from mecp_env.logs import Log, read_log
from mecp_env.render.screen import map_picture

MAPS = Path("runs/real")  # pictures of each log, and of the first start in each plan


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
    *(f"karto_{name}" for name in (*ERRORS, *FINAL_ERRORS, "ms_per_scan_mean", "loops")),
)


def calibrated(name: str) -> tuple[Log, Calibration | None]:
    """A log of `shared/data`, and its calibration where it is run with one."""
    folder = shared_data("logs")
    assert folder is not None
    log = read_log(folder / f"{name}.npz")
    return log, calibrate_log(log, config_for(log), {}, {}) if LOGS[name].calibrated else None


def map_log(name: str, seed: int, scans: int | None = None) -> Figures:
    """Metrics of one run on a log, and of OpenKarto where it is installed; only of its first `scans` if given."""
    log, calibration = calibrated(name)
    options = LOGS[name].run.model_copy(update={"seed": seed, "scans": scans})
    run = run_log(log, run=options, calibration=calibration)
    if seed == 0:
        MAPS.mkdir(parents=True, exist_ok=True)
        Image.fromarray(map_picture(final_view(run, name))).save(MAPS / f"{name}.png")
    if not is_installed(karto.PACKAGE):
        return run.metrics()
    rows, raw = np.searchsorted(run.log.t, run.t), run.log.T_odom_robot
    odometry = run.T_odom_robot if raw is None else raw[rows]  # made of the reference path, or that of the log
    return run.metrics() | karto.figures(run.log, rows, odometry)


def summarise(runs: list[dict[str, Any]]) -> Figures:
    """Figures of a log: means over the runs with 95 % intervals, plain numbers of a single run.

    Those of a run that ended early are of the part of the log before; a figure without anything to measure is missing.
    """
    found = {name: [run[name] for run in runs] for name in COLUMNS if np.isfinite(runs[0].get(name, np.nan))}
    figures = {name: estimate(values) if len(runs) > 1 else values[0] for name, values in found.items()}
    ends = sorted({str(run["ended"]) for run in runs})
    return {**figures, "runs": len(runs), "scans": runs[0]["scans"], "ended": ", ".join(ends)}
