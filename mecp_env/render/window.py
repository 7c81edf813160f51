"""The window of the `human` render mode. Only here is a display touched.

The strip below a frame with what the keys do.
"""

from __future__ import annotations

import logging
import os
from functools import cache

import numpy as np
import pygame

from mecp_env.core.carriers import Bytes
from mecp_env.core.errors import ConfigError
from mecp_env.render import palette
from mecp_env.render.brush import Brush

HEIGHT, MARGIN = 62, 12  # px: of the strip, at its sides


def key_strip(width: int, keys: str, message: str) -> Bytes:
    """A strip (HEIGHT,width,3): what the keys do, and below that a message."""
    brush = Brush((width, HEIGHT), palette.PAPER)
    brush.line(np.array([[MARGIN, 1.0], [width - MARGIN, 1.0]]), palette.UNSEEN)
    brush.text(keys, (MARGIN, 12), 18, palette.MUTED)
    brush.text(message, (MARGIN, 36), 20)
    return brush.image()


log = logging.getLogger(__name__)

UNSEEN = ("dummy", "offscreen")  # drivers that SDL takes where there is no display; their windows are not visible
FIX = "start it on a desktop or with DISPLAY set (ssh -X, xvfb-run), or do without the window"


def require_display() -> str:
    """SDL's driver of windows. Raises `ConfigError` where none could be seen, unless SDL_VIDEODRIVER asks for that."""
    try:
        pygame.display.init()
        driver = pygame.display.get_driver()
        if is_unseen(driver):
            raise pygame.error("there is no display")
        return driver
    except pygame.error as error:
        raise ConfigError(f"render_mode: 'human' can open no window ({error}); {FIX}") from None
    finally:
        pygame.display.quit()


def is_unseen(driver: str) -> bool:
    """True for a driver whose windows nobody sees, unless SDL_VIDEODRIVER asks for it."""
    return driver in UNSEEN and not os.environ.get("SDL_VIDEODRIVER")


@cache
def warn_unseen() -> None:
    """Say once that there is a window and nobody sees it."""
    log.warning("mecp_env: render_mode='human' without a display: nothing can be seen; %s", FIX)


class Window:
    """Shows frames. When the user closes it, the episode goes on without a window."""

    def __init__(self, title: str) -> None:
        self.title = title
        self.closed = False
        self._surface: pygame.Surface | None = None

    def show(self, frame: Bytes) -> None:
        """Draw a picture as `draw` does, and see whether the user closes the window."""
        self.draw(frame)
        self.events()

    def draw(self, frame: Bytes) -> None:
        """Draw a picture (height, width, 3), opening the window before the first one.

        Raises `ConfigError` where no window can be opened.
        """
        if self.closed:
            return
        surface = self._surface or self._open(frame.shape[1], frame.shape[0])
        pygame.surfarray.blit_array(surface, frame.transpose(1, 0, 2))
        pygame.display.flip()

    def events(self) -> list[pygame.event.Event]:
        """What the user did since the last call; closing the window is done, too."""
        events = [] if self.closed else pygame.event.get()
        if any(event.type == pygame.QUIT for event in events):
            self.close()
        return events

    def close(self) -> None:
        """Close the window; may be called twice, and without a window."""
        if self._surface is not None:
            pygame.display.quit()
        self._surface = None
        self.closed = True

    def _open(self, width: int, height: int) -> pygame.Surface:
        try:
            pygame.display.init()
            self._surface = pygame.display.set_mode((width, height))
        except pygame.error as error:
            pygame.display.quit()
            raise ConfigError(f"render_mode: 'human' can open no window ({error}); {FIX}") from None
        if is_unseen(pygame.display.get_driver()):
            warn_unseen()
        pygame.display.set_caption(self.title)
        return self._surface
