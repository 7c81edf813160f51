"""A page that plays a run: what is recorded of each step, and the page itself.

The names are loaded when they are first used: a page is read without the messages of the estimator.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mecp_env.render.replay.page import ReplayError, play_again, read_page, write_page
    from mecp_env.render.replay.recorder import Recorder

__all__ = ["Recorder", "ReplayError", "play_again", "read_page", "write_page"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{'recorder' if name == 'Recorder' else 'page'}"), name)
