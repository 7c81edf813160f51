"""Colours shared by frames and figures, as RGB 0..255.

What a floor plan is drawn from: plain data in metres, world frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mecp_env.core.carriers import Array

RGB = tuple[int, int, int]

PAPER: RGB = (250, 250, 248)
INK: RGB = (38, 44, 54)
MUTED: RGB = (86, 94, 107)  # of text beside what matters more
FAINT: RGB = (118, 125, 136)  # of lines and marks, not of text
SOLID: RGB = (70, 77, 90)
FREE: RGB = (255, 255, 255)
UNSEEN: RGB = (224, 227, 231)
TRUTH: RGB = (120, 126, 136)
TRUE_WALL: RGB = (184, 186, 191)  # below the polygons of a map
TRUE_PATH: RGB = (155, 159, 165)  # below the estimated one
ESTIMATE: RGB = (31, 90, 200)
HIT: RGB = (214, 60, 60)
BEAM: RGB = (120, 170, 240)
LANDMARK: RGB = (176, 24, 48)
MOVER: RGB = (120, 70, 160)
POLYGON: RGB = (194, 24, 122)
DOOR: RGB = (224, 140, 0)
GOAL: RGB = (20, 140, 90)
PLACE: RGB = (120, 100, 190)

ROOMS: tuple[RGB, ...] = (
    (76, 120, 168),
    (84, 162, 75),
    (178, 105, 162),
    (228, 130, 50),
    (70, 175, 170),
    (200, 80, 90),
    (150, 118, 90),
    (205, 175, 45),
    (110, 100, 190),
    (235, 140, 160),
    (105, 140, 60),
    (90, 105, 120),
)


# Okabe and Ito's colours, which the colour-blind can tell apart, the darkest first; lines have a marker and dashes too.
SERIES: tuple[RGB, ...] = (
    (0, 114, 178),
    (213, 94, 0),
    (0, 158, 115),
    (204, 121, 167),
    (38, 44, 54),
    (230, 159, 0),
    (86, 180, 233),
)
MARKERS = "osD^vPX"


def room_colour(room: int) -> RGB:
    """The colour of a room id; grey where the room is not known."""
    return ROOMS[room % len(ROOMS)] if room >= 0 else FAINT


def mix(colour: RGB, other: RGB, share: float) -> RGB:
    """`colour` with `share` (0..1) of `other` in it."""
    red, green, blue = (round(a + share * (b - a)) for a, b in zip(colour, other, strict=True))
    return red, green, blue


def unit(colour: RGB) -> tuple[float, float, float]:
    """The colour as matplotlib wants it, 0..1."""
    return colour[0] / 255, colour[1] / 255, colour[2] / 255


LINES = 2.3  # height of name and area, in heights of a letter
LETTER = 0.62  # width of a letter, in its height
Shape = tuple[Array, ...]  # rings (k,2): the outside, then the holes


@dataclass(frozen=True, slots=True, eq=False)
class PlanRoom:
    """A room, and where its name has space."""

    name: str
    ring: Array  # (k,2) its floor up to the middle of its walls
    area_m2: float  # of its floor: without walls, furniture, and solids that stand in it
    colour: int  # index of a colour that no neighbour has
    label: tuple[float, float]  # middle of the name
    label_height_m: float  # so high may name and area be together
    label_turn_deg: float  # along which the name is written, above -80, at most 100


@dataclass(frozen=True, slots=True, eq=False)
class FloorPlan:
    """A building as a picture needs it."""

    name: str
    walls: tuple[Shape, ...]  # solid walls, doors not yet cut out
    rooms: tuple[PlanRoom, ...]
    doors: tuple[Array, ...]  # (4,2) the gap of each
    obstacles: tuple[Array, ...]  # (k,2)
    starts: Array  # (n,3) x, y, heading
    free_m2: float  # floor that a robot can see, doorways included

    @property
    def bounds(self) -> Array:
        """(2,2) lower left and upper right corner of the walls."""
        points = np.concatenate([shape[0] for shape in self.walls])
        return np.stack([points.min(axis=0), points.max(axis=0)])

    @property
    def summary(self) -> str:
        """Its figures in a line."""
        width, height = self.bounds[1] - self.bounds[0]
        rooms, doors = (_count(len(n), word) for n, word in ((self.rooms, "room"), (self.doors, "door")))
        return f"{rooms}, {doors}, {self.free_m2:.0f} m² of floor, {width:.1f} x {height:.1f} m"


def _count(n: int, word: str) -> str:
    return f"{n} {word}" if n == 1 else f"{n} {word}s"
