"""Recorded logs of a laser and odometry: CARMEN text, ROS bags and NumPy archives (docs/logs.md)."""

from mecp_env.logs.log import Log, LogRecord
from mecp_env.logs.reader import read_log
from mecp_env.logs.recording import ReadOptions

__all__ = ["Log", "LogRecord", "ReadOptions", "read_log"]
