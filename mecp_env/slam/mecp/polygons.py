"""Maximum Empty Convex Polygons: the polygon division of III-A.2."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from mecp_env.core.array_types import Array, Bools, Ints
from mecp_env.core.errors import ConfigError, MecpError
from mecp_env.slam.config import PolygonConfig
from mecp_env.slam.mecp.edge_labels import wall_beams
from mecp_env.slam.mecp.search import around_leftmost, around_robot, best_rings, twice_area
from mecp_env.slam.mecp.wall_crossing import polygons_of_scan
from mecp_env.slam.messages import Clusters, Corners, MergedScan, Polygon


def largest_empty_convex_polygons(
    points: ArrayLike,
    robot: ArrayLike | None = None,
    *,
    robot_on_edge: bool = False,
    tolerance: float = 0.0,
    ties: Literal["area", "cardinality"] = "area",
) -> list[tuple[int, ...]]:
    """The largest empty convex polygons of `points`: index tuples, counter-clockwise from the smallest index.

    Largest is most vertices, then largest area: what is returned shares both, in order of ids. With
    `ties="cardinality"` all polygons with most vertices come back, the larger areas first; there can be very many.
    Without any polygon (fewer than three points, all on one line, robot outside) the list is empty.

    Args:
        points: (n,2) any unit of length. Of exact duplicates the first is used.
        robot: (2,) must lie strictly inside the polygon; None: no such condition.
        robot_on_edge: a robot on the boundary counts as inside.
        tolerance: same unit. A vertex lies farther than this from the chord of its neighbours, and a point blocks only
            if it lies farther than this inside the edge behind it, as seen from the robot (without a robot, or with
            `robot_on_edge`: from the leftmost vertex, and then inside the edges at that vertex too).
        ties: "area" or "cardinality".

    With tolerance 0 vertices are strict and a point on the boundary does not block (mode `open`). Exact as
    long as products of coordinate differences are exact in float64, as for integers below 2**25.

    Raises:
        MecpError: points or robot are not finite or not of that shape.
        ConfigError: tolerance is negative or not finite, or ties is unknown.

    Source: III-A.2; Dobkin, Edelsbrunner, Overmars, "Searching for empty convex polygons", Algorithmica 5, 1990, with
    the corrections of derivations 1.3: containment by edges, left turns instead of slopes.
    """
    given = _finite("points", points, 2)
    center = None if robot is None else _finite("robot", robot, 1)
    _check_options(tolerance, ties)
    given, center, tolerance = _to_unit_size(given, center, tolerance)
    sites, ids = _distinct(given)
    weight = 1.0 if ties == "area" else 0.0
    if center is None or robot_on_edge:
        found = around_leftmost(sites, center, float(tolerance), weight)
    else:
        found = around_robot(sites - center, float(tolerance), weight)
    rings = best_rings(found, ids)
    return rings if ties == "area" else sorted(rings, key=lambda ring: -twice_area(given[list(ring)]))


def _to_unit_size(points: Array, robot: Array | None, tolerance: float) -> tuple[Array, Array | None, float]:
    """All three divided by one power of two, which changes no digit: products can neither overflow nor vanish."""
    largest = max(np.abs(points).max(initial=0.0), 0.0 if robot is None else np.abs(robot).max())
    exponent = -math.frexp(largest)[1]
    scaled = None if robot is None else np.ldexp(robot, exponent)
    return np.ldexp(points, exponent), scaled, math.ldexp(float(tolerance), exponent)


def _check_options(tolerance: float, ties: str) -> None:
    number = isinstance(tolerance, int | float | np.number) and not isinstance(tolerance, bool)
    if not (number and 0.0 <= tolerance < math.inf):
        raise ConfigError(f"tolerance: {tolerance!r} is not a finite number >= 0")
    if ties not in ("area", "cardinality"):
        raise ConfigError(f"ties: {ties!r} is not 'area' or 'cardinality'")


def _finite(name: str, given: ArrayLike, dimensions: int) -> Array:
    """`given` as floats of shape (n,2) or (2,); an empty list stands for (0,2)."""
    array = _as_floats(name, given)
    if dimensions == 2 and array.size == 0:
        return np.empty((0, 2))
    if array.ndim != dimensions or array.shape[-1] != 2:
        raise MecpError(f"{name}: shape {array.shape} is not {'(n, 2)' if dimensions == 2 else '(2,)'}")
    if not np.isfinite(array).all():
        raise MecpError(f"{name}: every coordinate must be finite, given {given!r:.80}")
    return array


def _as_floats(name: str, given: ArrayLike) -> Array:
    if np.iscomplexobj(given):
        raise MecpError(f"{name}: complex coordinates, {given!r:.80}")
    try:
        return np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise MecpError(f"{name}: {given!r:.80} are no numbers") from None


def _distinct(points: Array) -> tuple[Array, Ints]:
    """The points without exact duplicates, and which index each had first."""
    if len(points) == 0:
        return points, np.empty(0, np.int64)
    first = np.sort(np.unique(points, axis=0, return_index=True)[1]).astype(np.int64)
    return np.ascontiguousarray(points[first]), first


def find_polygons(
    corners: Corners, beams: MergedScan, config: PolygonConfig, wall: Bools | None = None
) -> tuple[Polygon, ...]:
    """The Maximum Empty Convex Polygons of a scan: the one with most vertices, of equals the largest (III-A.2).

    Sites are `corners.sites`. If they give no polygon of four, the jambs of this side of the doors count too (a
    corridor between doors has little else); if even that gives none of four, a triangle of the first attempt comes
    back, or else of the second: good for free space, not for matching. Polygons with equally many vertices are rare
    and both of use: the `keep_ties` largest come back, the larger area first.

    The tolerance is `tolerance_sigmas` times the median sigma of the sites; where beams are compared with an edge,
    times the larger sigma of its two corners. Polygons that walls cross are ruled out (`check_walls`) by the beams: all
    of them, or those that end on a wall according to `wall` (B,) (`beams_on_walls`). The beams also cut each edge into
    intervals WALL, GAP and OPEN.

    Differs from the paper: strict turns with tolerance, area decides between equals, jambs only where the other corners
    are too few, the wall-crossing check (derivations 1).
    """
    if wall is None or not config.check_walls:
        wall = np.full(len(beams.ranges), config.check_walls)
    ids, intervals, ends = polygons_of_scan(
        (corners.z, corners.cov, corners.sites, corners.kind, corners.beyond, corners.doorways.jambs),
        (beams.ranges, beams.bearings, wall),
        config.record,
    )
    found, at, row = [], 0, 0
    for end, last_row in ends.tolist():
        found.append(Polygon(ids[at:end], intervals[row:last_row]))
        at, row = end, last_row
    return tuple(found)


def beams_on_walls(clusters: Clusters, beams: MergedScan) -> Bools:
    """(B,) which beams are on clusters with lines, and may cross a polygon. Pillars and people are not walls."""
    return wall_beams(clusters.roll, clusters.first, clusters.last, clusters.kind, len(beams.ranges))
