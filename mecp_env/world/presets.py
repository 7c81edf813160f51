"""Wheels that exist: fields of `OdometryConfig` by name (sources: docs/sensors.md)."""

from __future__ import annotations

from typing import Any

WHEELS: dict[str, dict[str, Any]] = {
    "paper": {},  # IV: the defaults of the fields
    "pioneer": {"distance_sigma_m": 0.0035, "turn_sigma_deg": 1.2, "turn_m": 0.26},  # differential drive
    "turtlebot": {"distance_sigma_m": 0.007, "turn_sigma_deg": 0.5, "turn_m": 1.0},  # differential drive, gyroscope
    "skid_steer": {  # four wheels that slide sideways in every turn
        "distance_sigma_m": 0.02,
        "turn_sigma_deg": 3.0,
        "turn_m": 2.0,
        "slip_share": 0.01,
    },
}
