"""The part of a plan's floor that a robot can reach, without specks and without rays through glass."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.errors import LayoutError
from mecp_env.floorplans.options import PlanOptions
from mecp_env.world.outline import ROBOT_RADIUS_M

CLEARANCE_M = ROBOT_RADIUS_M + 0.02
BESIDE_M = 3.0 * CLEARANCE_M  # what is further away from a place does not bound it
NICHE_M = 0.4  # a niche too narrow for the robot stays when it is no deeper
SHALLOW = 0.9  # a part smaller than this share of a depth reaches no deeper, wherever its mouth is
FINE_M = 2e-3  # details smaller than this come from rounding
ON_EDGE_M = 1e-6  # the middle of an edge this close to a line is on it
SPECK_M2 = 0.02  # solids smaller than this are dirt


def without_hollows(area: BaseGeometry) -> Polygon:
    """`area` without what only slits too narrow for the robot lead to, as the hollows of double walls."""
    return largest_part(_closed(area, CLEARANCE_M, _inner(area, CLEARANCE_M), NICHE_M))


def reachable_floor(area: BaseGeometry) -> Polygon:
    """The part of `area` around the largest place that a robot can drive about in; no specks in it.

    Passages that are too narrow end where they begin. Raises LayoutError when nothing is wide enough.
    """
    floor = largest_part(_closed(area, CLEARANCE_M, largest_part(_inner(area, CLEARANCE_M)), NICHE_M))
    return Polygon(floor.exterior, [hole for hole in floor.interiors if Polygon(hole).area >= SPECK_M2])


def left_out(floor: Polygon, area: Polygon, options: PlanOptions) -> str:
    """Which places of a `floor`, as large as a room, are not part of the building's `area`, in words; or nothing."""
    near = _around_large_parts(floor.difference(area), options.smallest_room_m2)
    inner = floor.intersection(near).buffer(-CLEARANCE_M, quad_segs=4).difference(area)
    places = shapely.buffer(shapely.get_parts(inner), CLEARANCE_M)
    sizes = shapely.area(places)[shapely.area(places) >= options.smallest_room_m2]
    if not len(sizes):
        return ""
    return f"Places that no wide enough doorway leads to: {len(sizes)}, of {sizes.sum():.1f} m2 in all."


def _around_large_parts(rest: BaseGeometry, least_m2: float) -> BaseGeometry:
    """Boxes around those parts of `rest` that may be a place of at least so much: the others are edges of pixels.

    They are so wide that a place in a part is the same whether the floor ends at its box or not.
    """
    left, bottom, right, top = shapely.bounds(shapely.get_parts(rest)).T
    large = (right - left + 2.0 * CLEARANCE_M) * (top - bottom + 2.0 * CLEARANCE_M) >= least_m2
    corners = [left - BESIDE_M, bottom - BESIDE_M, right + BESIDE_M, top + BESIDE_M]
    return shapely.union_all(shapely.box(*(corner[large] for corner in corners)))


def _inner(area: BaseGeometry, radius: float) -> BaseGeometry:
    """Where in `area` the centre of a circle may be."""
    inner = area.buffer(-radius, quad_segs=4)
    if inner.is_empty:
        raise LayoutError(
            f"no floor is wide enough for a radius of {ROBOT_RADIUS_M} m; check the scale, and that floor is bright, "
            "on dark walls"
        )
    return inner


def largest_part(area: BaseGeometry) -> Polygon:
    """The connected part of `area` with most of it, counter-clockwise."""
    return orient(max(shapely.get_parts(area), key=lambda part: part.area), 1.0)


def _closed(area: BaseGeometry, radius: float, inner: BaseGeometry, depth: float) -> BaseGeometry:
    """`area` without the parts that circles with centres in `inner` do not cover, where those are deep."""
    wide = inner.buffer(radius + 0.5 * FINE_M, quad_segs=4)
    return area.difference(_deep_parts(area.difference(wide), wide, depth).buffer(1e-6)).simplify(FINE_M)


def _deep_parts(rest: BaseGeometry, wide: BaseGeometry, depth: float) -> BaseGeometry:
    """The parts of `rest` that reach further than `depth` from their mouths, each up to the line across its mouth."""
    parts = shapely.get_parts(rest)
    mouths = _mouths(parts, wide)
    left, bottom, right, top = shapely.bounds(parts).T
    deep = (np.hypot(right - left, top - bottom) > SHALLOW * depth) | shapely.is_empty(mouths)
    deep[deep] = ~shapely.covers(shapely.buffer(mouths[deep], depth), parts[deep])
    arcs = shapely.get_parts(shapely.line_merge(mouths[deep]))
    arcs = arcs[shapely.get_num_coordinates(arcs) > 3]
    fronts = [Polygon(arc.coords) for arc in arcs]
    return shapely.union_all([*parts[deep], *(shapely.make_valid(front).buffer(0.5 * FINE_M) for front in fronts)])


def _mouths(parts: NDArray[np.object_], wide: BaseGeometry) -> NDArray[np.object_]:
    """Where each of `parts` ends at `wide`: lines, empty for a part that does not touch it."""
    edges, part = _edges(parts)
    tree = shapely.STRtree(shapely.linestrings(_edges(shapely.get_parts(wide))[0]))
    touching = np.unique(tree.query(shapely.points(edges.mean(axis=1)), "dwithin", ON_EDGE_M)[0])
    mouths = np.full(len(parts), shapely.MultiLineString(), dtype=np.object_)
    shapely.multilinestrings(shapely.linestrings(edges[touching]), indices=part[touching], out=mouths)
    return mouths


def _edges(parts: NDArray[np.object_]) -> tuple[Array, Ints]:
    """The edges (n,2,2) of polygons, and the index (n,) of the polygon that each belongs to."""
    rings, part = shapely.get_rings(parts, return_index=True)
    points, ring = shapely.get_coordinates(rings, return_index=True)
    within = ring[1:] == ring[:-1]
    return np.stack([points[:-1], points[1:]], axis=1)[within], part[ring[1:][within]]
