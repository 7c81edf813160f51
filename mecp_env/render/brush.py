"""Lines, areas and text on a pygame-ce surface that is finer than the picture it becomes. Touches no display."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pygame

from mecp_env.core.carriers import Array, Bytes
from mecp_env.core.files import sanitised
from mecp_env.render.palette import INK, PAPER, RGB

Place = Sequence[float] | Array

HALO = tuple((dx, dy) for dx in (-1.5, 0.0, 1.5) for dy in (-1.5, 0.0, 1.5) if dx or dy)  # px around a letter
FINER = 2  # pixels of the surface a pixel of the picture: smooth lines and text


@dataclass(frozen=True, slots=True)
class Box:
    """A rectangle of the picture, px."""

    left: int
    top: int
    width: int
    height: int

    @property
    def middle(self) -> tuple[float, float]:
        return self.left + self.width / 2, self.top + self.height / 2


@dataclass(frozen=True, slots=True)
class Camera:
    """Where a point of the world lies in the picture: pixels = (x, -y) * scale + offset."""

    scale: float  # px / m
    offset: tuple[float, float]  # px

    @classmethod
    def fit(cls, bounds: Array, box: Box) -> Camera:
        """The camera that shows `bounds` (2,2) m, world frame, in the middle of `box`."""
        size = np.maximum(bounds[1] - bounds[0], 1.0)
        scale = 0.97 * float(min(box.width / size[0], box.height / size[1]))
        x, y = bounds.mean(axis=0)
        return cls(scale, (box.middle[0] - scale * x, box.middle[1] + scale * y))

    def pixels(self, p_world: Array) -> Array:
        """Points (n,2) m of the world as pixels (n,2)."""
        pixels: Array = p_world * (self.scale, -self.scale) + self.offset
        return pixels

    def pixel_centres(self, box: Box) -> tuple[Array, Array]:
        """World coordinates, m, of the middles of the pixels in `box`: x (width,), and y (height,) from the top."""
        x = (box.left + (np.arange(box.width, dtype=np.float64) + 0.5) - self.offset[0]) / self.scale
        y = (box.top + (np.arange(box.height, dtype=np.float64) + 0.5) - self.offset[1]) / -self.scale
        return x, y


class Brush:
    """Draws on one picture of `size` (width, height). All places and lengths are pixels of the picture."""

    def __init__(self, size: tuple[int, int], background: RGB) -> None:
        pygame.font.init()
        self.size = size
        self.canvas = pygame.Surface((FINER * size[0], FINER * size[1]), depth=32)
        self.canvas.fill(background)
        self._fonts: dict[int, pygame.font.Font] = {}

    def image(self, fine: bool = False) -> Bytes:
        """The picture, uint8 (height, width, 3), or the surface itself, which is finer."""
        small = self.canvas if fine else pygame.transform.smoothscale(self.canvas, self.size)
        return np.ascontiguousarray(pygame.surfarray.array3d(small).transpose(1, 0, 2))

    @contextmanager
    def inside(self, box: Box) -> Iterator[None]:
        """Nothing outside `box` is drawn upon."""
        self.canvas.set_clip((*self._fine(box), FINER * box.width, FINER * box.height))
        yield
        self.canvas.set_clip(None)

    def area(self, ring: Array, colour: RGB) -> None:
        """Fill a ring (k,2)."""
        if len(ring) > 2:
            pygame.draw.polygon(self.canvas, colour, (FINER * ring).tolist())

    def veil(self, rings: Sequence[tuple[Array, RGB]], alpha: int) -> None:
        """Lay translucent areas over the picture; where they overlap the last one counts, and it grows no darker."""
        layer = pygame.Surface(self.canvas.get_size(), pygame.SRCALPHA)
        for ring, colour in rings:
            pygame.draw.polygon(layer, (*colour, alpha), (FINER * ring).tolist())
        self.canvas.blit(layer, (0, 0))

    def line(self, points: Array, colour: RGB, width: float = 1.0) -> None:
        """A line through the points (n,2)."""
        if len(points) > 1:
            pygame.draw.lines(self.canvas, colour, False, (FINER * points).tolist(), round(FINER * width))

    def ring(self, points: Array, colour: RGB, width: float = 1.0) -> None:
        """A closed line through the points (n,2)."""
        self.line(np.vstack([points, points[:1]]), colour, width)

    def dashes(self, start: Array, end: Array, colour: RGB, width: float = 1.5) -> None:
        """A line of dashes of about five pixels."""
        count = max(int(np.hypot(*(end - start)) / 10.0), 1)
        cuts = start + np.linspace(0.0, 1.0, 2 * count)[:, None] * (end - start)
        for dash in cuts.reshape(count, 2, 2):
            self.line(dash, colour, width)

    def dot(self, place: Place, radius: float, colour: RGB, width: float = 0.0) -> None:
        """A disc, or with a width a circle."""
        at = (FINER * place[0], FINER * place[1])
        pygame.draw.circle(self.canvas, colour, at, FINER * radius, round(FINER * width))

    def square(self, place: Place, radius: float, colour: RGB, width: float = 0.0) -> None:
        """A square of about the size of that disc, or with a width its outline."""
        left, top, side = FINER * (place[0] - 0.9 * radius), FINER * (place[1] - 0.9 * radius), FINER * 1.8 * radius
        pygame.draw.rect(self.canvas, colour, (left, top, side, side), round(FINER * width))

    def picture(self, pixels: Bytes, box: Box) -> None:
        """A small picture (h,w,3), stretched over `box`."""
        surface = pygame.surfarray.make_surface(pixels.transpose(1, 0, 2))
        self.canvas.blit(pygame.transform.scale(surface, (FINER * box.width, FINER * box.height)), self._fine(box))

    def text(self, words: str, place: Place, size: int, colour: RGB = INK, align: float = 0.0) -> float:
        """Words whose left end (align 0), middle (0.5) or right end (1) is at `place`; returns their width."""
        font = self._fonts.setdefault(size, pygame.font.Font(None, FINER * size))
        drawn = font.render(sanitised(words), True, colour)
        self.canvas.blit(drawn, (FINER * place[0] - align * drawn.get_width(), FINER * place[1]))
        return float(drawn.get_width() / FINER)

    def label(self, words: str, place: Place, size: int) -> None:
        """Dark words around `place` with a light halo: readable on whatever is below them."""
        left, top = place[0], place[1] - 0.35 * size
        for dx, dy in HALO:
            self.text(words, (left + dx, top + dy), size, PAPER, align=0.5)
        self.text(words, (left, top), size, INK, align=0.5)

    @staticmethod
    def _fine(box: Box) -> tuple[int, int]:
        return FINER * box.left, FINER * box.top
