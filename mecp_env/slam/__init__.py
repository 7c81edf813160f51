"""The estimator: from scans and odometry to pose, landmarks, rooms, doors and a semantic grid.

It runs alone on recorded data: `SlamPipeline(SlamConfig())`, then `start(scan)` and `step(odometry, scan)`. The names
below are loaded when they are first used, so that a section of the configuration does not load the compiled functions.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mecp_env.core.sensors import Odometry, Scan
    from mecp_env.slam.checks import MatchError, SensorError
    from mecp_env.slam.config import SlamConfig
    from mecp_env.slam.map_file import MapError, SlamMap
    from mecp_env.slam.output import SlamOutput
    from mecp_env.slam.pipeline import SlamPipeline

__all__ = [
    "MapError",
    "MatchError",
    "Odometry",
    "Scan",
    "SensorError",
    "SlamConfig",
    "SlamMap",
    "SlamOutput",
    "SlamPipeline",
]

MODULES = {
    "MapError": "mecp_env.slam.map_file",
    "MatchError": "mecp_env.slam.checks",
    "Odometry": "mecp_env.core.sensors",
    "Scan": "mecp_env.core.sensors",
    "SensorError": "mecp_env.slam.checks",
    "SlamConfig": "mecp_env.slam.config",
    "SlamMap": "mecp_env.slam.map_file",
    "SlamOutput": "mecp_env.slam.output",
    "SlamPipeline": "mecp_env.slam.pipeline",
}


def __getattr__(name: str) -> Any:
    if name not in MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(MODULES[name]), name)
