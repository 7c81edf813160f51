"""A small picture of the belief with a line above: one of several side by side."""

from __future__ import annotations

from mecp_env.render import palette
from mecp_env.render.brush import Box, Brush, Image
from mecp_env.render.panels import draw_belief
from mecp_env.render.view import SceneView

MARGIN, HEADER = 8, 44


def thumbnail(view: SceneView, size: tuple[int, int], title: str, caption: str) -> Image:
    """What the robot believes at one moment, uint8 (height, width, 3); `size` is width and height, px."""
    brush = Brush(size, palette.PAPER)
    box = Box(MARGIN, HEADER, size[0] - 2 * MARGIN, size[1] - HEADER - MARGIN)
    with brush.inside(box):
        draw_belief(brush, view, box)
    brush.text(title, (MARGIN, 6), 22)
    brush.text(caption, (MARGIN, 25), 17, palette.FAINT)
    return brush.image()
