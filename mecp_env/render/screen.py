"""Frames of an episode: ground truth at the left, the estimate at the right, figures above, a legend below."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from mecp_env.core.carriers import Array, Bytes
from mecp_env.core.settings import Settings
from mecp_env.render import palette
from mecp_env.render.brush import Box, Brush
from mecp_env.render.panels import draw_belief, draw_nothing, draw_scan, draw_world
from mecp_env.render.shapes import KNOWN_GROUND, SceneView, magnification, summary

MARGIN, HEADER, FOOTER = 12, 58, 28
SMALL_MARGIN, SMALL_HEADER = 8, 44  # of a thumbnail
Legend = tuple[tuple[str, palette.RGB, str], ...]
LEGEND: Legend = (
    ("true path", palette.TRUTH, "line"),
    ("laser hit", palette.HIT, "dot"),
    ("estimated path", palette.ESTIMATE, "line"),
    ("recognised polygon", palette.POLYGON, "line"),
    ("door", palette.DOOR, "line"),
    ("goal", palette.GOAL, "dot"),
    ("room: one colour each", palette.ROOMS[0], "dot"),
)
PLACE_LEGEND: Legend = (("known ground", palette.PLACE, "square"),)
MOVER_LEGEND: Legend = (("pedestrian, box", palette.MOVER, "square"),)


class ScreenConfig(Settings):
    """Size of a frame."""

    width_px: int = Field(1200, ge=320, le=4096)
    height_px: int = Field(520, ge=200, le=4096)

    @classmethod
    def around(cls, bounds: Array, width_px: int) -> ScreenConfig:
        """The size at which a building with these `bounds` (2,2) m fills both halves, within what fits a screen."""
        across, up = np.maximum(bounds[1] - bounds[0], 1.0).tolist()
        half = (width_px - 3 * MARGIN) / 2
        height = HEADER + FOOTER + round(min(max(half * up / across, 0.4 * half), 1.4 * half))
        return cls(width_px=width_px, height_px=height + height % 2)


class Screen:
    """Draws frames of one size; touches no display (the window of the `human` mode is in window.py)."""

    def __init__(self, config: ScreenConfig | None = None) -> None:
        self.config = config or ScreenConfig()

    def frame(self, view: SceneView, hide_world: bool = False) -> Bytes:
        """The picture of one moment, uint8 (height, width, 3); the world can be left out."""
        brush = Brush((self.config.width_px, self.config.height_px), palette.PAPER)
        world, belief = self._panels()
        with brush.inside(world):
            (draw_nothing if hide_world else draw_world)(brush, view, world)
        with brush.inside(belief):
            draw_belief(brush, view, belief)
        brush.text("The world: true walls, robot and scan", (world.left, 36), 18, palette.MUTED)
        brush.text("The belief: what the agent is given", (belief.left, 36), 18, palette.MUTED)
        self._header(brush, view)
        places = PLACE_LEGEND if (view.goal_kinds >= KNOWN_GROUND).any() else ()
        scale = f"landmark, 95 % ellipse x {magnification(view.slam_output.belief):.0f}", palette.LANDMARK, "dot"
        self._legend(brush, (*LEGEND, scale) + places + (MOVER_LEGEND if len(view.moving) else ()))
        return brush.image()

    def _panels(self) -> tuple[Box, Box]:
        width = (self.config.width_px - 3 * MARGIN) // 2
        height = self.config.height_px - HEADER - FOOTER
        return Box(MARGIN, HEADER, width, height), Box(2 * MARGIN + width, HEADER, width, height)

    def _header(self, brush: Brush, view: SceneView) -> None:
        brush.text(view.title, (MARGIN, 10), 24)
        x = float(self.config.width_px - MARGIN)
        for name, value in reversed(summary(view.metrics)):
            x -= brush.text(value, (x, 11), 22, align=1.0) + 5
            x -= brush.text(name, (x, 13), 18, palette.MUTED, align=1.0) + 16

    def _legend(self, brush: Brush, legend: Legend) -> None:
        x, y = float(MARGIN), self.config.height_px - FOOTER + 6
        for name, colour, kind in legend:
            if kind == "dot":
                brush.dot((x + 6, y + 6), 3.5, colour)
            elif kind == "square":
                brush.square((x + 6, y + 6), 4.0, colour, 1.5)
            else:
                brush.line(np.array([[x, y + 6], [x + 12, y + 6]]), colour, 2.5)
            x += 18 + brush.text(name, (x + 18, y), 16, palette.MUTED) + 18


def thumbnail(view: SceneView, size: tuple[int, int], title: str, caption: str, scan: bool = False) -> Bytes:
    """What the robot believes at one moment, uint8 (height, width, 3); `size` is width and height, px."""
    brush = Brush(size, palette.PAPER)
    box = Box(SMALL_MARGIN, SMALL_HEADER, size[0] - 2 * SMALL_MARGIN, size[1] - SMALL_HEADER - SMALL_MARGIN)
    with brush.inside(box):
        draw_belief(brush, view, box)
        if scan:
            draw_scan(brush, view, box)
    brush.text(title, (SMALL_MARGIN, 6), 22)
    brush.text(caption, (SMALL_MARGIN, 25), 17, palette.MUTED)
    return brush.image()
