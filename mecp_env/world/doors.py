"""Doors and rooms of a building: which are closed in an episode, and figures of both.

Closed doors become wall, and what lies behind them is not part of the building.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from shapely.geometry import Point, Polygon

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.world.config import ClutterConfig
from mecp_env.world.outline import GAP_POST_M, Outline, build_outline
from mecp_env.world.schema import DoorSpec, Layout, Solid, Start

START_M = 0.6  # a door closer to the start than this, beyond half its width, stays open
LEAST_M2 = 0.05  # a room with a smaller reachable share is unreachable
NARROW = 3.0  # smallest ratio of length to width of a corridor


def draw_closed(outline: Outline, start: Array, config: ClutterConfig, rng: np.random.Generator) -> Ints:
    """Which doors are closed: each with the probability `config.closed_doors`, as long as enough rooms are left.

    A door stays open if without it fewer than `config.reachable_share` of the rooms that could be reached from `start`
    (2,) m were left. With a probability of 0, nothing is drawn from `rng`.
    """
    if config.closed_doors == 0.0:
        return np.empty(0, np.int64)
    doors = outline.doors
    far = np.hypot(*(doors.centre - start[:2]).T) > START_M + 0.5 * doors.width
    drawn = rng.random(len(doors))
    wanted = np.flatnonzero((drawn < config.closed_doors) & far)
    home = int(np.argmin(shapely.distance(np.array(outline.rooms), Point(start[:2]))))
    is_open = np.ones(len(doors), np.bool_)
    least = config.reachable_share * _rooms_left(outline, is_open, home)
    for door in wanted[np.argsort(drawn[wanted])]:
        is_open[door] = False
        is_open[door] = _rooms_left(outline, is_open, home) < least
    return np.flatnonzero(~is_open)


def _rooms_left(outline: Outline, is_open: Bools, home: int) -> int:
    """How many rooms can be reached from room `home` through the open doors."""
    _, group = _joined(outline, is_open)
    return int(np.sum(group == group[home]))


def _joined(outline: Outline, is_open: Bools) -> tuple[int, Ints]:
    """Into how many groups the open doors join the rooms, and the group (r,) of each room."""
    count, (one, other) = len(outline.rooms), outline.doors.rooms[is_open].T
    graph = csr_array((np.ones(len(one)), (one, other)), shape=(count, count))
    groups, group = connected_components(graph, directed=False)
    return int(groups), np.asarray(group, np.int64)


def close_doors(layout: Layout, closed: Ints, start: Array) -> Layout:
    """The layout without those doors, and without the rooms that are then unreachable from `start` (2,) m."""
    if not len(closed):
        return layout
    shut = set(closed.tolist())
    doors = tuple(door for i, door in enumerate(layout.doors) if i not in shut)
    starts = (Start(point=(float(start[0]), float(start[1]))),)
    solids = (*layout.solids, *(_leaf(layout.doors[i]) for i in sorted(shut) if layout.doors[i].opening == "gap"))
    rest = layout.model_copy(update={"doors": doors, "starts": starts, "solids": solids})
    free = build_outline(rest).free_area
    rooms = tuple(room for room in layout.rooms if Polygon(room.polygon).intersection(free).area > LEAST_M2)
    names = {room.name for room in rooms}
    return rest.model_copy(update={"rooms": rooms, "doors": tuple(d for d in doors if names.issuperset(d.rooms))})


def _leaf(door: DoorSpec) -> Solid:
    """The solid that fills a gap, with its ends in the adjacent walls."""
    depth, heading = door.depth_m or 0.0, door.heading
    through = 0.5 * depth * np.array([math.cos(heading), math.sin(heading)])
    along = (0.5 * door.width_m + GAP_POST_M) * np.array([-math.sin(heading), math.cos(heading)])
    ring = door.centre + np.stack([-through - along, through - along, through + along, along - through])
    return Solid(outer=tuple((float(x), float(y)) for x, y in ring))


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


def building_figures(layout: Layout) -> BuildingFigures:
    """The figures of a checked layout."""
    outline = build_outline(layout)
    x0, y0, x1, y1 = outline.bounds
    return BuildingFigures(
        rooms=len(outline.rooms),
        doors=len(outline.doors),
        loops=len(outline.doors) - len(outline.rooms) + _joined(outline, np.ones(len(outline.doors), np.bool_))[0],
        floor_m2=float(outline.free_area.area),
        faces=len(outline.segments),
        corners=len(outline.corners),
        obstacles=len(layout.obstacles),
        longest_corridor_m=max(map(_corridor_m, outline.rooms)),
        width_m=x1 - x0,
        height_m=y1 - y0,
    )


def _corridor_m(room: Polygon) -> float:
    """Length of a room that is narrow, else 0."""
    ring = np.array(room.minimum_rotated_rectangle.exterior.coords)
    length = float(np.linalg.norm(np.diff(ring[:3], axis=0), axis=1).max())
    return length if length**2 >= NARROW * room.area else 0.0
