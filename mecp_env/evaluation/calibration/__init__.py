"""Calibration of a robot from its own scans and odometry (docs/logs.md)."""

from mecp_env.evaluation.calibration.models import (
    CORRECTIONS,
    FIELDS,
    OF_SENSOR,
    Calibration,
    Estimate,
    calibrate,
    calibrate_log,
)

__all__ = ["CORRECTIONS", "FIELDS", "OF_SENSOR", "Calibration", "Estimate", "calibrate", "calibrate_log"]
