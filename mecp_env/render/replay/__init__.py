"""The replay of a run: one HTML page that plays it in a browser and shows why the robot believes what it believes."""

from mecp_env.render.replay.page import ReplayError, read_page, write_page
from mecp_env.render.replay.recorder import Recorder

__all__ = ["Recorder", "ReplayError", "read_page", "write_page"]
