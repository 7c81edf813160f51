"""The options of a plan, and the output of every importer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import AfterValidator, BeforeValidator, Field
from shapely.geometry import Point, Polygon

from mecp_env.core.carriers import Array
from mecp_env.core.settings import Settings, as_range

Width = Annotated[float, Field(ge=0.3, le=4.0)]


def _ordered(limits: tuple[float, float]) -> tuple[float, float]:
    if limits[0] >= limits[1]:
        raise ValueError("two widths, the narrower first")
    return limits


class PlanOptions(Settings):
    """How a plan is read."""

    resolution_m: float | None = Field(None, ge=0.005, le=1.0)  # side of a pixel; only for images without a yaml
    free_above: int | None = Field(None, ge=0, le=254)  # grey levels above this are floor; None: Otsu's threshold
    door_width_m: Annotated[tuple[Width, Width], BeforeValidator(as_range), AfterValidator(_ordered)] = (0.3, 1.9)
    door_depth_m: float = Field(1.0, ge=0.05, le=2.0)  # a longer passage is a corridor, not a door
    straighten: bool = True  # turn edges to the dominant directions of the building
    smallest_room_m2: float = Field(1.0, ge=0.2, le=100.0)


@dataclass(frozen=True, slots=True, eq=False)
class Crossing:
    """A place where one walks through a door, before the door is measured."""

    middle: Array  # (2,) m
    along: Array  # (2,) unit vector from post to post


@dataclass(frozen=True, slots=True, eq=False)
class FreeSpace:
    """What an importer reads from a file: the floor, and what the file says about its rooms."""

    name: str
    description: str
    area: Polygon  # m, world frame
    noise_m: float  # how far its edges are from the true walls
    labels: tuple[tuple[str, Polygon], ...] = ()  # names of rooms and roughly where they lie
    crossings: tuple[Crossing, ...] | None = None  # None: doors have to be found
    drawn: tuple[tuple[str, Point], ...] = ()  # where the file has each room, and a point in it; all have to be found
