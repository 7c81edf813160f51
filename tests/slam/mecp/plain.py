"""The plain twin of the polygon search: all rings by definition."""

import itertools
import math

import numpy as np

from mecp_env.slam.mecp.cycles import order_by_bearing


def cross(a, b):
    return a[0] * b[1] - a[1] * b[0]


def twice_area(points, ring):
    return sum(cross(points[a], points[b]) for a, b in zip(ring, ring[1:] + ring[:1], strict=True))


def random_sites(rng, n, tolerance):
    """Sites around the origin by bearing; with tolerance 0 on a coarse grid, so that rays and lines coincide."""
    points = rng.uniform(-3, 3, (n, 2)) if tolerance else np.unique(rng.integers(-3, 4, (n, 2)), axis=0) + 0.0
    points = points[(points != 0).any(axis=1)]
    return np.ascontiguousarray(points[order_by_bearing(points)])


def convex_rings(points):
    """All strictly convex rings of distinct points: a subset is one if each vertex has all others left of one edge."""
    left = {}
    for a, b in itertools.permutations(range(len(points)), 2):
        turns = [cross(points[b] - points[a], p - points[a]) for p in points]
        left[a, b] = {c for c, turn in enumerate(turns) if turn > 0}
    for size in range(3, len(points) + 1):
        for subset in itertools.combinations(range(len(points)), size):
            after = {a: b for a, b in itertools.permutations(subset, 2) if {*subset} - {a, b} <= left[a, b]}
            if len(after) == size:
                ring = [subset[0]]
                while len(ring) < size:
                    ring.append(after[ring[-1]])
                yield tuple(ring)


def is_empty_around(points, ring, robot):
    """Whether the robot, and no point, lies in the open ring."""
    sides = [(points[a], points[b]) for a, b in zip(ring, ring[1:] + ring[:1], strict=True)]

    def inside(p):
        return all(cross(b - a, p - a) > 0 for a, b in sides)

    return inside(robot) and not any(map(inside, points))


def blocks(s, a, b, tolerance):
    """Whether site s lies in the closed sector from a to b, more than `tolerance` left of the edge."""
    depth = cross(b - a, s - a) / np.hypot(*(b - a))
    return cross(a, s) >= 0 and cross(s, b) >= 0 and depth > tolerance


def plain_visible_edges(points, tolerance):
    n = len(points)
    allowed = np.zeros((n, n), bool)
    for i, j in itertools.permutations(range(n), 2):
        others = [points[k] for k in range(n) if k not in (i, j)]
        spans = cross(points[i], points[j]) > 0
        allowed[i, j] = spans and not any(blocks(s, points[i], points[j], tolerance) for s in others)
    return allowed


def is_strict(points, a, b, c, tolerance):
    """True when b is a vertex between a and c."""
    turn = cross(points[b] - points[a], points[c] - points[b])
    return turn > 0 and turn > tolerance * math.hypot(*(points[c] - points[a]))


def allowed_rings(points, tolerance):
    """All polygons around the origin, by definition."""
    allowed = plain_visible_edges(points, tolerance)
    for ring in convex_rings(points):
        before, after = ring[-1:] + ring[:-1], ring[1:] + ring[:1]
        if all(allowed[a, b] for a, b in zip(ring, after, strict=True)) and all(
            is_strict(points, *corner, tolerance) for corner in zip(before, ring, after, strict=True)
        ):
            yield ring
