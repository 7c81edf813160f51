"""HouseExpo: a home as one polygon of its floor in metres, the inner walls folded in as fingers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from shapely.geometry import Polygon, box
from shapely.validation import explain_validity

from mecp_env.core.errors import LayoutError
from mecp_env.core.settings import shown
from mecp_env.floorplans.files import require
from mecp_env.floorplans.options import FreeSpace
from mecp_env.world.schema import EXTENT_M

MAX_VERTICES = 20_000
MAX_LABELS = 500
STAIRS_M = 0.03  # slanted walls are stairs of 1-2 cm


def read_houseexpo(document: dict[str, Any], path: Path) -> FreeSpace:
    """The floor of a HouseExpo document, and the boxes of its rooms as labels; they overlap and overshoot."""
    verts = document.get("verts")
    if not isinstance(verts, list) or not 3 <= len(verts) <= MAX_VERTICES:
        raise LayoutError(f"verts: a list of 3 to {MAX_VERTICES} points expected (given: {shown(verts)})")
    points = [_numbers(point, 2, f"verts.{i}") for i, point in enumerate(verts)]
    area = Polygon(points)
    if not area.is_valid:
        raise LayoutError(f"verts: not a simple polygon ({explain_validity(area)})")
    note = f"HouseExpo {str(document.get('id', path.stem))[:80]}"
    return FreeSpace(path.stem[:80], note, area, STAIRS_M, _labels(document.get("room_category", {})))


def _numbers(given: Any, count: int, field: str) -> tuple[float, ...]:
    if not isinstance(given, list) or len(given) != count:
        raise LayoutError(f"{field}: {count} numbers expected (given: {shown(given)})")
    return tuple(require(value, f"{field}.{i}", -EXTENT_M, EXTENT_M) for i, value in enumerate(given))


def _labels(given: Any) -> tuple[tuple[str, Polygon], ...]:
    if not isinstance(given, dict) or not all(isinstance(boxes, list) for boxes in given.values()):
        raise LayoutError(f"room_category: names with lists of boxes expected (given: {shown(given)})")
    if sum(map(len, given.values())) > MAX_LABELS:
        raise LayoutError(f"room_category: {sum(map(len, given.values()))} boxes, at most {MAX_LABELS}")
    return tuple(
        (name.replace("_", " ")[:60] or "room", box(*_numbers(corners, 4, f"room_category.{name[:60]}.{i}")))
        for name, boxes in given.items()
        for i, corners in enumerate(boxes)
    )
