"""The specification of a generated building, the presets, and the seeds of the splits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from mecp_env.core.errors import ConfigError
from mecp_env.core.settings import Settings, as_many, as_range, guess, shown
from mecp_env.world.config import ordered

Difficulty = Literal["easy", "medium", "hard", "huge"]
Shape = Literal["L", "T", "U"]
Piece = Literal["shelf", "box", "square_pillar", "round_pillar"]
Single, Ordered, Word = BeforeValidator(as_range), AfterValidator(ordered), BeforeValidator(as_many)
Side = Annotated[float, Field(ge=2.4, le=15.0)]
Thickness = Annotated[float, Field(ge=0.05, le=0.4)]
Width = Annotated[float, Field(ge=0.6, le=2.0)]
Turn = Annotated[float, Field(ge=-180.0, le=180.0)]
Shapes = Annotated[tuple[Shape, ...], Field(min_length=1, fail_fast=True), Word]

ROOMS_OF = {"rectangle": 1, "L": 2, "U": 2, "T": 3, "yard": 0}  # a shape with those that fill its notches

# seeds of the buildings; train on the first, select on the second, report on the third
SPLITS: dict[str, range] = {
    "train": range(1_000_000),
    "validation": range(1_000_000, 1_001_000),
    "test": range(2_000_000, 2_001_000),
}


@dataclass(eq=False)
class Rejected(Exception):
    """Why a try failed: the field that it could not meet, and the value that it reached."""

    field: str
    most: float = 0.0


class GeneratorSpec(Settings):
    """A building to generate; ranges (low, high) are drawn from evenly, a single number is the range of itself.

    Rooms, doors, corridors, shapes and slanted corners come out exactly, furniture within 15 % (or the nearest whole
    piece); a specification of which no building can be found is refused.
    """

    rooms: int = Field(8, ge=2, le=200)  # corridors are rooms too
    loops: int = Field(0, ge=0, le=100)  # doors beyond those that join all rooms: rooms - 1 + loops doors
    corridors: int = Field(0, ge=0, le=40)  # of the rooms so many; at most one for three others
    corridor_width_m: Annotated[tuple[Width, Width], Single, Ordered] = (1.6, 2.0)  # between the middles of its walls
    room_side_m: Annotated[tuple[Side, Side], Single, Ordered] = (3.2, 5.5)  # the side of a square of the room's area
    shaped_rooms: int = Field(0, ge=0, le=60)  # rooms that are not rectangles
    shapes: Shapes = ("L", "T", "U")  # what those may be
    yards: int = Field(0, ge=0, le=10)  # parts of the plot that are not built on
    slanted_corners: int = Field(0, ge=0, le=3)  # outer corners of the building cut off by a slanted wall
    turned_deg: Annotated[tuple[Turn, Turn], Single, Ordered] = (0.0, 0.0)  # the whole building against the axes
    wall_thickness_m: Annotated[tuple[Thickness, Thickness], Single, Ordered] = (0.12, 0.12)  # one for the building
    door_width_m: Annotated[tuple[Width, Width], Single, Ordered] = (0.9, 0.9)  # drawn for each door
    max_doors: int = Field(4, ge=1, le=20)  # of a room; corridors may have any number
    # pieces on 10 m^2 of rooms, none in corridors; in rooms of 3.2-5.5 m about 2 find room (boxes 1), over 6 m 3
    furniture: float = Field(0.0, ge=0.0, le=3.0)
    # what the furniture may be
    pieces: Annotated[tuple[Piece, ...], Field(min_length=1, fail_fast=True), Word] = (
        "shelf",
        "box",
        "square_pillar",
        "round_pillar",
    )

    @classmethod
    def preset(cls, difficulty: str = "medium", **fields: Any) -> Self:
        """The specification of a difficulty, with `fields` over it. Raises `ConfigError` for an unknown one."""
        if not isinstance(difficulty, str) or difficulty not in DIFFICULTIES:
            known, nearest = ", ".join(DIFFICULTIES), guess(difficulty, DIFFICULTIES)
            raise ConfigError(f"difficulty: {shown(difficulty)} is not one of {known}{nearest}")
        return cls(**(DIFFICULTIES[difficulty] | fields))

    def drawn_thickness_m(self, rng: np.random.Generator) -> float:
        """A thickness of the walls, in whole millimetres where the range has one."""
        low, high = self.wall_thickness_m
        return min(max(round(float(rng.uniform(low, high)), 3), low), high)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        plain = self.rooms - self.corridors
        needed = self.shaped_rooms * max(ROOMS_OF[shape] for shape in self.shapes)
        if needed > plain:
            raise ValueError(f"shaped_rooms: {self.shaped_rooms} with their notches need {needed} rooms, {plain} left")
        if self.corridors and plain < 3 * self.corridors:
            raise ValueError(f"corridors: {self.corridors}, at most one for three rooms beside them")
        width, side = self.door_width_m[1], self.room_side_m[0]
        if width > side - 1.5:
            raise ValueError(f"door_width_m: up to {width:g} m is too wide for rooms of {side:g} m")
        return self

    def require_doors(self) -> None:
        """Raise `ConfigError` for doors that no plan can have.

        No two join the same rooms, and the plan is flat: one of n rooms has at most 3n - 6 doors (Euler).
        """
        ends = (self.rooms - self.corridors) * self.max_doors + self.corridors * (self.rooms - 1)
        least, most = self.rooms - 1, min(max(3 * self.rooms - 6, 1), ends // 2)
        if most < least:
            raise ConfigError(f"max_doors: {self.max_doors}, too few to join {self.rooms} rooms")
        if self.loops > most - least:
            raise ConfigError(
                f"loops: {self.loops} loops, at most {most - least} with {self.rooms} rooms on one floor, "
                f"{self.corridors} of them corridors, the others of at most {self.max_doors} doors each"
            )


DIFFICULTIES: dict[str, dict[str, Any]] = {
    "easy": {"rooms": 4, "room_side_m": (3.5, 6.0)},
    "medium": {"rooms": 8, "loops": 1, "corridors": 1, "shaped_rooms": 1, "furniture": 0.3},
    "hard": {
        "rooms": 14,
        "loops": 3,
        "corridors": 2,
        "shaped_rooms": 3,
        "yards": 1,
        "slanted_corners": 2,
        "turned_deg": (-45.0, 45.0),
        "wall_thickness_m": (0.1, 0.2),
        "door_width_m": (0.8, 1.0),
        "furniture": 0.8,
    },
    "huge": {
        "rooms": 40,
        "loops": 8,
        "corridors": 4,
        "shaped_rooms": 6,
        "yards": 2,
        "slanted_corners": 2,
        "turned_deg": (-45.0, 45.0),
        "furniture": 0.5,
    },
}


def unknown_split(split: object) -> str:
    """The message for an unknown split."""
    return f"split: {shown(split)} is not one of {', '.join(SPLITS)}{guess(split, SPLITS)}"


def split_seed(split: str, index: int) -> int:
    """The seed of building `index` of a split. Raises `ConfigError` for an unknown split or an index outside."""
    if not isinstance(split, str) or split not in SPLITS:
        raise ConfigError(unknown_split(split))
    if not 0 <= index < len(SPLITS[split]):
        raise ConfigError(f"index: {index}, split {split!r} has {len(SPLITS[split])} buildings")
    return SPLITS[split][index]
