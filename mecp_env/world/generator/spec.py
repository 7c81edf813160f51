"""What a generated building shall be, the presets, and the seeds of the splits."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from mecp_env.errors import ConfigError
from mecp_env.settings import Settings

Difficulty = Literal["easy", "medium", "hard", "huge"]
Shape = Literal["L", "T", "U"]
Piece = Literal["shelf", "box", "square_pillar", "round_pillar"]
Side = Annotated[float, Field(ge=2.4, le=15.0)]
Thickness = Annotated[float, Field(ge=0.05, le=0.4)]
Width = Annotated[float, Field(ge=0.6, le=2.0)]
Turn = Annotated[float, Field(ge=-180.0, le=180.0)]

ROOMS_OF = {"rectangle": 1, "L": 2, "U": 2, "T": 3, "yard": 0}  # a shape with those that fill its notches

# seeds of the buildings; whoever reports results trains on the first, chooses on the second, reports the third
SPLITS: dict[str, range] = {
    "train": range(1_000_000),
    "validation": range(1_000_000, 1_001_000),
    "test": range(2_000_000, 2_001_000),
}


class GeneratorSpec(Settings):
    """A building to generate; ranges (low, high) are drawn from evenly.

    Rooms, doors, corridors and shapes come out exactly; slanted corners and furniture as far as there is room for them.
    """

    rooms: int = Field(8, ge=2, le=60)  # corridors are rooms too
    loops: int = Field(0, ge=0, le=30)  # doors beyond those that join all rooms: rooms - 1 + loops doors
    corridors: int = Field(0, ge=0, le=8)
    corridor_width_m: tuple[Width, Width] = (1.6, 2.0)
    room_side_m: tuple[Side, Side] = (3.2, 5.5)  # the side of a square of the room's area
    shaped_rooms: int = Field(0, ge=0, le=20)  # rooms that are no rectangle
    shapes: Annotated[tuple[Shape, ...], Field(min_length=1)] = ("L", "T", "U")  # which they may be
    yards: int = Field(0, ge=0, le=10)  # parts of the plot that are not built on
    slanted_corners: int = Field(0, ge=0, le=3)  # outer corners of the building cut off by a slanted wall
    turned_deg: tuple[Turn, Turn] = (0.0, 0.0)  # the whole building against the axes
    wall_thickness_m: tuple[Thickness, Thickness] = (0.12, 0.12)
    door_width_m: tuple[Width, Width] = (0.9, 0.9)
    max_doors: int = Field(4, ge=1, le=20)  # of a room; corridors may have any number
    furniture: float = Field(0.0, ge=0.0, le=3.0)  # pieces on 10 m^2, as far as there is room for them
    pieces: Annotated[tuple[Piece, ...], Field(min_length=1)] = ("shelf", "box", "square_pillar", "round_pillar")

    @classmethod
    def preset(cls, difficulty: str = "medium", **fields: Any) -> Self:
        """The specification of a difficulty, with `fields` over it. Raises `ConfigError` for an unknown one."""
        if difficulty not in DIFFICULTIES:
            raise ConfigError(f"difficulty: {difficulty!r:.80} is none of {', '.join(DIFFICULTIES)}")
        return cls(**(DIFFICULTIES[difficulty] | fields))

    @model_validator(mode="after")
    def _fits(self) -> Self:
        for name in ("corridor_width_m", "room_side_m", "turned_deg", "wall_thickness_m", "door_width_m"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name}: ({low:g}, {high:g}) is no range, the lower end comes first")
        plain = self.rooms - self.corridors
        needed = self.shaped_rooms * max(ROOMS_OF[shape] for shape in self.shapes)
        if needed > plain:
            raise ValueError(
                f"shaped_rooms: {self.shaped_rooms} with their notches need {needed} rooms, {plain} are left"
            )
        if self.corridors and plain < 3 * self.corridors:
            raise ValueError(f"corridors: {self.corridors}, at most one for three rooms beside them")
        if self.door_width_m[1] > self.room_side_m[0] - 1.5:
            raise ValueError(
                f"door_width_m: up to {self.door_width_m[1]:g} m is too wide for rooms of {self.room_side_m[0]:g} m"
            )
        return self


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


def split_seed(split: str, index: int) -> int:
    """The seed of building `index` of a split. Raises `ConfigError` for an unknown split or an index outside."""
    if split not in SPLITS:
        raise ConfigError(f"split: {split!r:.80} is none of {', '.join(SPLITS)}")
    if not 0 <= index < len(SPLITS[split]):
        raise ConfigError(f"index: {index}, split {split!r} has {len(SPLITS[split])} buildings")
    return SPLITS[split][index]
