"""HouseExpo: a home as one polygon of its floor in metres, the inner walls folded in as fingers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import ConfigDict, Field, field_validator
from shapely.geometry import Polygon, box
from shapely.validation import explain_validity

from mecp_env.core.errors import LayoutError
from mecp_env.floorplans.options import FreeSpace
from mecp_env.world.schema import Document, Length, Point

MAX_VERTICES = 20_000
MAX_LABELS = 500
STAIRS_M = 0.03  # slanted walls are stairs of 1-2 cm

Box = tuple[Length, Length, Length, Length]  # x, y of two opposite corners


class House(Document):
    """The fields of a HouseExpo file that are used."""

    model_config = ConfigDict(extra="ignore")

    verts: Annotated[tuple[Point, ...], Field(min_length=3, max_length=MAX_VERTICES, fail_fast=True)]
    id: Any
    room_category: dict[str, tuple[Box, ...]] = Field({})  # name: boxes of the rooms, which overlap and overshoot

    @field_validator("room_category")
    @classmethod
    def _are_few(cls, boxes: dict[str, tuple[Box, ...]]) -> dict[str, tuple[Box, ...]]:
        if sum(map(len, boxes.values())) > MAX_LABELS:
            raise ValueError(f"{sum(map(len, boxes.values()))} boxes, at most {MAX_LABELS}")
        return boxes


def read_houseexpo(document: dict[str, Any], path: Path) -> FreeSpace:
    """The floor of a HouseExpo document, and the boxes of its rooms as labels."""
    house = House(**({"id": path.stem} | document))
    area = Polygon(house.verts)
    if not area.is_valid:
        raise LayoutError(f"verts: not a simple polygon ({explain_validity(area)})")
    rooms = ((name.replace("_", " ")[:60] or "room", boxes) for name, boxes in house.room_category.items())
    labels = tuple((name, box(*corners)) for name, boxes in rooms for corners in boxes)
    return FreeSpace(path.stem[:80], f"HouseExpo {house.id!s:.80}", area, STAIRS_M, labels)
