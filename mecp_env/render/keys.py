"""The strip below a frame with the meaning of each key."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mecp_env.core.array_types import Bytes
from mecp_env.render import palette
from mecp_env.render.brush import Box, Brush

HEIGHT, MARGIN, CAP = 62, 12, 22  # px: of the strip, at its sides, of a key
KeyHelp = tuple[Sequence[str], str]  # labels of the keys, what they do


def key_strip(width: int, keys: Sequence[KeyHelp], message: str) -> Bytes:
    """A strip (HEIGHT,width,3): keys with what they do, and below them a message."""
    brush = Brush((width, HEIGHT), palette.PAPER)
    brush.line(np.array([[MARGIN, 1.0], [width - MARGIN, 1.0]]), palette.UNSEEN)
    x = float(MARGIN)
    for caps, meaning in keys:
        for cap in caps:
            x += _draw_cap(brush, cap, x) + 3
        x += 4 + brush.text(meaning, (x + 4, 13), 17, palette.mix(palette.INK, palette.FREE, 0.25)) + 16
    brush.text(message, (MARGIN, 39), 20, palette.INK)
    return brush.image()


def _draw_cap(brush: Brush, cap: str, x: float) -> int:
    """A key at `x`; how wide it is."""
    width = CAP if cap in ARROWS else max(CAP, 12 + 7 * len(cap))
    key = Box(round(x), 7, width, CAP)
    ring = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * [key.width, key.height] + np.array([key.left, key.top])
    brush.area(ring, palette.FREE)
    brush.ring(ring, palette.FAINT)
    if cap in ARROWS:
        brush.area(key.middle + ARROWS[cap], palette.INK)
    else:
        brush.text(cap, (key.middle[0], key.top + 5), 17, palette.INK, align=0.5)
    return width


POINT = np.array([[0.0, -4.5], [4.5, 3.5], [-4.5, 3.5]])  # a triangle upwards; the font has no arrows
QUARTER = np.array([[0.0, 1.0], [-1.0, 0.0]])
ARROWS = {"up": POINT, "right": POINT @ QUARTER, "down": -POINT, "left": -POINT @ QUARTER}
