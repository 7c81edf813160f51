"""Door frames that straight walls would lose: posts of a pixel or two on both sides of a corridor."""

from __future__ import annotations

import numpy as np
import shapely
from shapely.geometry import Polygon

from mecp_env.core.carriers import Array
from mecp_env.floorplans.door_detection import FRAME_WIDTH_M, Gap, Walls, doorways, extent, find_doors
from mecp_env.floorplans.furniture import without_furniture
from mecp_env.floorplans.options import PlanOptions
from mecp_env.floorplans.reachable_floor import largest_part

APART_M = 0.6  # a frame is no part of a doorway that is further away
INTO_WALL_M = 0.15  # how far a post reaches into its wall
STANDING_OUT_M = (0.08, 0.25)  # how far a post stands out
POST_M, THICKEST_M = 0.1, 0.16  # thickness of a post


def with_frames(area: Polygon, drawn: Polygon, axes: tuple[float, ...], options: PlanOptions) -> Polygon:
    """`area`, which has straight walls, with the door frames that `drawn` has and where it has no doorway."""
    narrow = options.model_copy(update={"door_width_m": (options.door_width_m[0], FRAME_WIDTH_M)})
    known = np.array([gap.centre for gap in find_doors(area, axes, options)]).reshape(-1, 2)
    found = doorways(Walls.around(without_furniture(drawn)), axes, narrow)
    frames = [gap for gap in found if _is_frame(gap) and _is_apart(gap, known)]
    walls = Walls.around(area)
    return largest_part(area.difference(shapely.union_all([post for gap in frames for post in _posts(gap, walls)])))


def _is_frame(gap: Gap) -> bool:
    """Thin posts that stand out a little."""
    return gap.depth_m <= THICKEST_M and gap.gain_m <= 2.0 * STANDING_OUT_M[1]


def _is_apart(gap: Gap, known: Array) -> bool:
    return bool(np.all(np.linalg.norm(known - gap.centre, axis=1) > APART_M))


def _posts(gap: Gap, walls: Walls) -> list[Polygon]:
    """The posts on both sides of a frame, from the `walls` inwards."""
    against, ahead = (float(side[0]) for side in extent(gap.centre[None], gap.along, walls))
    half = 0.5 * max(gap.depth_m, POST_M)
    ends = []
    for wall, sign in ((against, -1.0), (ahead, 1.0)):
        inner, outer = sign * min(0.5 * gap.width_m, wall - STANDING_OUT_M[0]), sign * (wall + INTO_WALL_M)
        ends.append(((inner, -half), (outer, -half), (outer, half), (inner, half)))
    return [Polygon([gap.centre + u * gap.along + v * gap.through for u, v in end]) for end in ends]
