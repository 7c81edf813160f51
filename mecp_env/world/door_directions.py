"""Which way a door leads, where the layout file leaves it to the wall."""

from __future__ import annotations

import math

import numpy as np
import shapely
from shapely.geometry import Point, Polygon

from mecp_env.world.outline import wall_lines
from mecp_env.world.schema import DoorSpec, Layout, RoomSpec


def with_directions(layout: Layout) -> Layout:
    """The same layout; a cut without `direction_deg` gets the one that is square to its wall and leads to its rooms."""
    if all(door.direction_deg is not None for door in layout.doors):
        return layout
    lines, thickness = wall_lines(layout)
    tree = shapely.STRtree(lines)

    def directed(door: DoorSpec) -> DoorSpec:
        if door.direction_deg is not None:
            return door
        nearest = int(tree.nearest(Point(door.centre)))
        (x0, y0), (x1, y1) = lines[nearest].coords
        square = math.degrees(math.atan2(x0 - x1, y1 - y0))
        step = thickness[nearest] / 2.0 + 0.05
        both = (round(square + turn, 9) for turn in (0.0, 180.0, -180.0))
        degrees = [deg + 0.0 for deg in both if -180.0 < deg <= 180.0]
        return door.model_copy(
            update={"direction_deg": max(degrees, key=lambda deg: _leads(door, deg, step, layout.rooms))}
        )

    return layout.model_copy(update={"doors": tuple(map(directed, layout.doors))})


def _leads(door: DoorSpec, direction_deg: float, step_m: float, rooms: tuple[RoomSpec, ...]) -> int:
    """How many of a point in front of the door and one behind it lie in the rooms that they should."""
    floors = {room.name: Polygon(room.polygon) for room in rooms if room.name in door.rooms}
    ahead = step_m * np.array([math.cos(math.radians(direction_deg)), math.sin(math.radians(direction_deg))])
    points = dict(zip(door.rooms, (door.centre - ahead, door.centre + ahead), strict=True))
    return sum(name in floors and floors[name].contains(Point(point)) for name, point in points.items())
