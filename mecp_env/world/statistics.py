"""Statistics of a building."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from shapely.geometry import Polygon

from mecp_env.world.outline import Outline, build_outline
from mecp_env.world.schema import Layout

NARROW = 3.0  # smallest ratio of length to width of a corridor


@dataclass(frozen=True, slots=True)
class BuildingFigures:
    """Counts and measures of one building; what cannot be reached from its first start is not counted as floor."""

    rooms: int
    doors: int
    loops: int  # doors that could be removed without disconnecting a room
    floor_m2: float
    faces: int  # straight faces of walls and obstacles visible to a laser
    corners: int
    obstacles: int
    longest_corridor_m: float  # the longest room that is narrow, 0 without one
    width_m: float  # along x
    height_m: float  # along y


def building_figures(layout: Layout, outline: Outline | None = None) -> BuildingFigures:
    """The statistics of a checked layout; `outline` if it is already built."""
    outline = outline or build_outline(layout)
    x0, y0, x1, y1 = outline.bounds
    return BuildingFigures(
        rooms=len(outline.rooms),
        doors=len(outline.doors),
        loops=_loops(outline),
        floor_m2=float(outline.free_area.area),
        faces=len(outline.segments),
        corners=len(outline.corners),
        obstacles=len(layout.obstacles),
        longest_corridor_m=max(map(_corridor_m, outline.rooms)),
        width_m=x1 - x0,
        height_m=y1 - y0,
    )


def _loops(outline: Outline) -> int:
    """Independent rings of the graph of rooms and doors."""
    a, b = outline.doors.rooms.T
    n = len(outline.rooms)
    parts, _ = connected_components(coo_array((np.ones(len(a)), (a, b)), shape=(n, n)), directed=False)
    return len(outline.doors) - n + int(parts)


def _corridor_m(room: Polygon) -> float:
    """Length of a room that is narrow, else 0."""
    ring = np.array(room.minimum_rotated_rectangle.exterior.coords)
    length = float(np.linalg.norm(np.diff(ring[:3], axis=0), axis=1).max())
    return length if length**2 >= NARROW * room.area else 0.0
