"""Why the result of a log is of no use, and which option to try."""

from __future__ import annotations

import numpy as np

from mecp_env.evaluation.log_run import REGISTERED, LogRun, LogRunConfig

FEW_SHARE = 0.1  # of the scans of a file are used, at least
LOST_SHARE, LOST_SCANS = 0.1, 5  # of the scans at the end, and at least so many: their pose is not known
AT_REST = "scans at rest, skipped"
DAMAGED = ("damaged lines", "damaged rows", "damaged messages")


def fault_of(run: LogRun, config: LogRunConfig) -> str | None:
    """The reason and what to try, where a run diverged, was lost to its end or used few of the scans; else None."""
    if run.ended == "diverged":
        return (
            f"diverged at {run.t[-1]:.3f} s: the odometry may be worse than its covariance: "
            "try --noise.scale 3, or --odometry none"
        )
    if run.ended != "complete":
        return None
    return _few(run, config) or _lost(run)


def _few(run: LogRun, config: LogRunConfig) -> str | None:
    """Where fewer than a tenth of the scans are used."""
    counts = run.counts
    found = run.log.found + sum(counts.get(name, 0) for name in DAMAGED)
    standard = LogRunConfig()
    asked = config.rest_m > standard.rest_m or config.rest_deg > standard.rest_deg or config.scans is not None
    resting = counts.get(AT_REST, 0)
    if len(run.t) + resting * asked >= FEW_SHARE * found:
        return None
    reason = f"{len(run.t)} of {found} scans are used"
    if 2 * resting > found and REGISTERED in run.notes:
        return f"{reason}, the robot is at rest by its scans in {resting}: a map takes a drive"
    if 2 * resting > found:
        return f"{reason}, the robot is at rest by its odometry in {resting}: try --odometry none"
    return f"{reason}: try --clock received, or --odometry none; what is left out is counted above"


def _lost(run: LogRun) -> str | None:
    """Where the pose is not known at the end."""
    known = np.flatnonzero(run.localised)
    last = int(known[-1]) if len(known) else -1
    lost = len(run.localised) - 1 - last
    if lost < max(LOST_SCANS, LOST_SHARE * len(run.localised)):
        return None
    since = f"from {run.t[last + 1]:.3f} s" if last >= 0 else "in the whole log"
    return (
        f"the pose is lost {since} to the end, nothing is mapped there: try --noise.scale 3, "
        "--config.localisation.explained-share 0 or --odometry none"
    )
