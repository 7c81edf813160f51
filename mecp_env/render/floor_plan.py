"""What a floor plan is drawn from: plain data in metres, world frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mecp_env.core.array_types import Array

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
