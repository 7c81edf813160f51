"""Doorways that are drawn too narrow for the robot: thick lines take from both jambs."""

from __future__ import annotations

import shapely
from shapely.geometry import Point, Polygon

from mecp_env.floorplans.door_detection import Gap, Walls, doorways, post_lengths
from mecp_env.floorplans.options import PlanOptions
from mecp_env.floorplans.reachable_floor import largest_part

DRIVEN_M = 0.6  # a doorway that the robot can drive through with a margin of 0.08 m
BESIDE_M = 0.35  # how far before and behind a doorway its rooms are looked up


def with_wider_doors(floor: Polygon, drawn: Polygon, axes: tuple[float, ...], options: PlanOptions) -> Polygon:
    """`floor`, which is `drawn` with straight edges, with doorways of at least `DRIVEN_M` between its rooms."""
    if options.door_width_m[0] >= DRIVEN_M:
        return floor
    places = shapely.get_parts(drawn.buffer(-DRIVEN_M / 2.0))
    rooms = shapely.buffer(places, DRIVEN_M / 2.0)
    large = rooms[shapely.area(rooms) >= options.smallest_room_m2]
    narrow = options.model_copy(update={"door_width_m": (options.door_width_m[0], DRIVEN_M)})
    tree, walls = shapely.STRtree(large), Walls.around(drawn)
    gaps = [gap for gap in doorways(walls, axes, narrow) if _joins_two(gap, tree)]
    return largest_part(shapely.union_all([floor, *(_wider(gap, walls) for gap in gaps)]))


def _joins_two(gap: Gap, rooms: shapely.STRtree) -> bool:
    sides = [Point(gap.centre + side * (0.5 * gap.depth_m + BESIDE_M) * gap.through) for side in (-1, 1)]
    before, behind = (set(rooms.query(point, predicate="within").tolist()) for point in sides)
    return bool(before and behind and not before & behind)


def _wider(gap: Gap, walls: Walls) -> Polygon:
    """The doorway with a width of `DRIVEN_M`, wider where the wall beside it goes on for longer."""
    against, ahead = post_lengths(gap.centre, gap.along, gap.width_m, walls)
    more = DRIVEN_M - gap.width_m + 0.01
    shares = (0.5, 0.5) if min(against, ahead) >= more else (float(against > ahead), float(ahead >= against))
    low, high = -0.5 * gap.width_m - shares[0] * more, 0.5 * gap.width_m + shares[1] * more
    half = 0.5 * gap.depth_m + 0.02
    corners = ((low, -half), (high, -half), (high, half), (low, half))
    return Polygon([gap.centre + u * gap.along + v * gap.through for u, v in corners])
