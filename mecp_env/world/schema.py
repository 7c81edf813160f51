"""The layout of a building as its file says it: walls, rooms, doors, obstacles, starts. JSON both ways."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError, model_validator

from mecp_env.errors import LayoutError
from mecp_env.settings import describe

EXTENT_M = 1000.0
MAX_WALLS = 10_000

Length = Annotated[float, Strict(), Field(ge=-EXTENT_M, le=EXTENT_M)]
Size = Annotated[float, Strict(), Field(ge=0.02, le=EXTENT_M)]
Degrees = Annotated[float, Strict(), Field(ge=-360.0, le=360.0)]
Point = tuple[Length, Length]
Ring = Annotated[tuple[Point, ...], Field(min_length=3, max_length=1000)]
Name = Annotated[str, Field(min_length=1, max_length=80)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Wall(_Part):
    """A wall as a thick solid: the polyline of its middle, with square ends."""

    points: Annotated[tuple[Point, ...], Field(min_length=2, max_length=1000)]
    thickness_m: Annotated[float, Strict(), Field(ge=0.02, le=5.0)] = 0.12

    @model_validator(mode="after")
    def _has_length(self) -> Self:
        for a, b in zip(self.points, self.points[1:], strict=False):
            if abs(a[0] - b[0]) + abs(a[1] - b[1]) < 0.01:
                raise ValueError(f"points {a} and {b} are less than 0.01 m apart")
        return self


class Room(_Part):
    """A room: its name and the polygon of its floor, drawn up to the middle of its walls."""

    name: Name
    polygon: Ring


class Door(_Part):
    """A doorway cut out of a wall."""

    centre: Point  # on the middle line of a wall
    width_m: Annotated[float, Strict(), Field(ge=0.1, le=20.0)] = 0.9
    rooms: tuple[Name, Name]
    direction_deg: Degrees  # heading of somebody who walks from the first room to the second


class Box(_Part):
    """A rectangular obstacle."""

    kind: Literal["box"]
    centre: Point
    size: tuple[Size, Size]  # along its own x and y
    turn_deg: Degrees = 0.0


class Block(_Part):
    """An obstacle with any simple outline."""

    kind: Literal["polygon"]
    points: Ring


class Pillar(_Part):
    """A round obstacle."""

    kind: Literal["round"]
    centre: Point
    radius_m: Annotated[float, Strict(), Field(ge=0.02, le=10.0)]


Obstacle = Annotated[Box | Block | Pillar, Field(discriminator="kind")]


class Start(_Part):
    """A pose from which an episode may start."""

    point: Point
    heading_deg: Degrees = 0.0


class Layout(_Part):
    """A building. A wrong field raises `LayoutError`; what is impossible as geometry is refused by `load_layout`."""

    format: Literal["mecp_env/layout"] = "mecp_env/layout"
    version: Literal[1] = 1
    name: Name
    description: Annotated[str, Field(max_length=2000)] = ""
    walls: Annotated[tuple[Wall, ...], Field(min_length=1, max_length=MAX_WALLS)]
    rooms: Annotated[tuple[Room, ...], Field(min_length=1, max_length=1000)]
    doors: Annotated[tuple[Door, ...], Field(max_length=2000)] = ()
    obstacles: Annotated[tuple[Obstacle, ...], Field(max_length=MAX_WALLS)] = ()
    starts: Annotated[tuple[Start, ...], Field(min_length=1, max_length=1000)]

    def __init__(self, **fields: Any) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise LayoutError(describe(error, "layout")) from None

    def room_index(self, name: str) -> int:
        """Index of the room called `name`, or -1."""
        return next((i for i, room in enumerate(self.rooms) if room.name == name), -1)

    def to_json(self) -> str:
        """The layout as a JSON text that a person can read: one wall, room, door, obstacle or start a line."""
        document = self.model_dump(mode="json")
        parts = [f"  {json.dumps(key)}: {_lines(value)}" for key, value in document.items()]
        return "{\n" + ",\n".join(parts) + "\n}\n"


def _lines(value: Any) -> str:
    """JSON of `value`; a list gets one line an entry."""
    if not isinstance(value, list) or not value:
        return json.dumps(value)
    return "[\n" + ",\n".join(f"    {json.dumps(entry)}" for entry in value) + "\n  ]"
