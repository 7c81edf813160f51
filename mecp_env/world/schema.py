"""The layout file of a building: walls, rooms, doors, obstacles, starts. JSON in both directions."""

from __future__ import annotations

import json
import math
from typing import Annotated, Any, Literal, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    Strict,
    ValidationError,
    model_validator,
)

from mecp_env.core.errors import LayoutError
from mecp_env.core.settings import describe, few

EXTENT_M = 1000.0
MAX_WALLS = 10_000
MAX_SOLID_POINTS = 20_000
MAX_FACES = 20_000  # of walls, solids, obstacles and rooms as if none touched another
ROUND_FACES = 32

Length = Annotated[float, Strict(), Field(ge=-EXTENT_M, le=EXTENT_M)]
Size = Annotated[float, Strict(), Field(ge=0.02, le=EXTENT_M)]
Degrees = Annotated[float, Strict(), Field(ge=-360.0, le=360.0)]
Point = tuple[Length, Length]
Ring = Annotated[tuple[Point, ...], Field(min_length=3, max_length=1000, fail_fast=True)]
LongRing = Annotated[tuple[Point, ...], Field(min_length=3, max_length=MAX_SOLID_POINTS, fail_fast=True)]
Name = Annotated[str, Field(min_length=1, max_length=80)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _has_few_fields(cls, fields: Any) -> Any:
        return few(fields)


class WallSpec(_Part):
    """A wall of constant thickness: its centre line with square ends."""

    points: Annotated[tuple[Point, ...], Field(min_length=2, max_length=1000, fail_fast=True)]
    thickness_m: Annotated[float, Strict(), Field(ge=0.02, le=5.0)] = 0.12

    @model_validator(mode="after")
    def _has_length(self) -> Self:
        for a, b in zip(self.points, self.points[1:], strict=False):
            if abs(a[0] - b[0]) + abs(a[1] - b[1]) < 0.01:
                raise ValueError(f"points {a} and {b} are less than 0.01 m apart")
        return self


class Solid(_Part):
    """Wall of any shape: the inside of `outer` without the holes."""

    outer: LongRing
    holes: Annotated[tuple[LongRing, ...], Field(max_length=MAX_WALLS, fail_fast=True)] = ()


class RoomSpec(_Part):
    """A room: its name and the polygon of its floor, up to the centre lines of its walls."""

    name: Name
    polygon: Ring


class DoorSpec(_Part):
    """A door: cut out of a wall, or a gap between solids."""

    centre: Point  # on the middle line of a wall; the middle of a gap
    width_m: Annotated[float, Strict(), Field(ge=0.1, le=20.0)] = 0.9
    rooms: tuple[Name, Name]
    direction_deg: Degrees | None = None  # heading from the first room to the second; `load_layout` asks the wall
    opening: Literal["cut", "gap"] = "cut"
    depth_m: Annotated[float, Strict(), Field(ge=0.01, le=5.0)] | None = None  # of a gap: the thickness of its wall

    @model_validator(mode="after")
    def _has_depth(self) -> Self:
        if (self.opening == "gap") != (self.depth_m is not None):
            raise ValueError("a gap has depth_m, a cut has none: its wall has a thickness")
        if self.opening == "gap" and self.direction_deg is None:
            raise ValueError("a gap has direction_deg, for no wall says it")
        return self

    @property
    def heading(self) -> float:
        """Radians, from the first room to the second; of a layout that `load_layout` returned."""
        assert self.direction_deg is not None
        return math.radians(self.direction_deg)


class BoxSpec(_Part):
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


Obstacle = Annotated[BoxSpec | Block | Pillar, Field(discriminator="kind")]


def faces_of(obstacle: BoxSpec | Block | Pillar) -> int:
    """Number of faces of an obstacle."""
    if isinstance(obstacle, Block):
        return len(obstacle.points)
    return 4 if isinstance(obstacle, BoxSpec) else ROUND_FACES


class Start(_Part):
    """A pose from which an episode may start."""

    point: Point
    heading_deg: Degrees = 0.0


class Document(_Part):
    """What a file holds; a wrong field raises `LayoutError`."""

    def __init__(self, **fields: Any) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise LayoutError(describe(error, type(self).__name__.lower(), type(self))) from None


class Layout(Document):
    """A building. A wrong field raises `LayoutError`; impossible geometry is refused by `load_layout`."""

    format: Literal["mecp_env/layout"] = "mecp_env/layout"
    version: Literal[1] = 1
    name: Name
    description: Annotated[str, Field(max_length=2000)] = ""
    solids: Annotated[tuple[Solid, ...], Field(max_length=MAX_WALLS, fail_fast=True)] = ()
    walls: Annotated[tuple[WallSpec, ...], Field(max_length=MAX_WALLS, fail_fast=True)]
    rooms: Annotated[tuple[RoomSpec, ...], Field(min_length=1, max_length=1000, fail_fast=True)]
    doors: Annotated[tuple[DoorSpec, ...], Field(max_length=2000, fail_fast=True)] = ()
    obstacles: Annotated[tuple[Obstacle, ...], Field(max_length=MAX_WALLS, fail_fast=True)] = ()
    starts: Annotated[tuple[Start, ...], Field(min_length=1, max_length=1000, fail_fast=True)]

    @model_validator(mode="after")
    def _has_walls_where_needed(self) -> Self:
        if not self.walls and not self.solids:
            raise ValueError("walls: at least 1 expected, for there are no solids")
        cut = next((i for i, door in enumerate(self.doors) if door.opening == "cut"), None)
        if cut is not None and not self.walls:
            raise ValueError(f"doors.{cut}.opening: cut, but the layout has no walls; solids have gaps")
        return self

    @model_validator(mode="after")
    def _has_few_faces(self) -> Self:
        rings = [ring for solid in self.solids for ring in (solid.outer, *solid.holes)]
        rings += [points for wall in self.walls for points in (wall.points, wall.points)]
        rings += [room.polygon for room in self.rooms]
        faces = sum(map(len, rings)) + sum(map(faces_of, self.obstacles))
        if faces > MAX_FACES:
            raise ValueError(
                f"walls, solids, obstacles, rooms: {faces} faces, at most {MAX_FACES} "
                f"(two for each point of a wall, one of a solid, room or polygon, 4 a box, {ROUND_FACES} a pillar)"
            )
        return self

    def to_json(self) -> str:
        """The layout as readable JSON: one wall, room, door, obstacle or start per line."""
        document = self.model_dump(mode="json", exclude=None if self.solids else {"solids"})
        document["doors"] = [_without_defaults(door) for door in document["doors"]]
        parts = [f"  {json.dumps(key)}: {_lines(value)}" for key, value in document.items()]
        return "{\n" + ",\n".join(parts) + "\n}\n"


def _without_defaults(door: dict[str, Any]) -> dict[str, Any]:
    """The JSON of a door; a cut is written without the fields of a gap, and without a direction that its wall says."""
    unset = {"opening", "depth_m"} if door["opening"] == "cut" else set()
    return {key: value for key, value in door.items() if key not in unset and value is not None}


def _lines(value: Any) -> str:
    """JSON of `value`; a list has one entry per line."""
    if not isinstance(value, list) or not value:
        return json.dumps(value)
    return "[\n" + ",\n".join(f"    {json.dumps(entry)}" for entry in value) + "\n  ]"
