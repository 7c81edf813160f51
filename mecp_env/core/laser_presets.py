"""Lasers that exist: fields of `LaserConfig` and, in part, of `SensorModel` by name (sources: docs/sensors.md).

A laser that sweeps while the robot drives gives one sweep per pose: `sweeps` is 1 but for the burst of the paper.
"""

from __future__ import annotations

from typing import Any

LASERS: dict[str, dict[str, Any]] = {
    "paper": {},  # IV: the defaults of the fields
    "ideal": {"range_sigma_m": 0.0, "bearing_sigma_deg": 0.0},
    "lms200": {  # SICK LMS 200, 80 m mode (cm), every 0.5 deg
        "field_of_view_deg": 180.0,
        "beams": 360,
        "sweeps": 1,
        "max_range_m": 80.0,
        "range_sigma_m": 0.01,
        "bearing_sigma_deg": 0.0,
        "grazing_deg": 85.0,
        "x_m": 0.15,
    },
    "urg04lx": {  # Hokuyo URG-04LX
        "field_of_view_deg": 239.77,
        "beams": 682,
        "sweeps": 1,
        "max_range_m": 5.6,
        "range_sigma_m": 0.01,
        "range_sigma_share": 0.01,
        "bearing_sigma_deg": 0.0,
        "grazing_deg": 80.0,
        "dark_share": 0.1,
        "dark_dropout": 0.2,
        "x_m": 0.15,
    },
    "utm30lx": {  # Hokuyo UTM-30LX
        "field_of_view_deg": 270.25,
        "beams": 1081,
        "sweeps": 1,
        "max_range_m": 30.0,
        "range_sigma_m": 0.01,
        "range_sigma_share": 0.001,
        "bearing_sigma_deg": 0.0,
        "grazing_deg": 85.0,
        "x_m": 0.15,
    },
    "rplidar_a1": {  # Slamtec RPLIDAR A1M8
        "beams": 360,
        "sweeps": 1,
        "max_range_m": 12.0,
        "range_sigma_m": 0.002,
        "range_sigma_share": 0.01,
        "bearing_sigma_deg": 0.0,
        "grazing_deg": 80.0,
        "dark_share": 0.1,
        "dark_dropout": 0.2,
    },
}
