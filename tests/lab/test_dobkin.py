"""The structure `dobkin`: the paper's search with its kernel rule, against brute force, and what the rule loses."""

import itertools

import numpy as np
import pytest

from mecp_env.lab.dobkin import rings_around
from tests.slam.mecp.plain import convex_rings, is_empty_around, twice_area

ROBOT = np.zeros(2)


def left(a, b, c):
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0


def leftmost(points, ring):
    return min(ring, key=lambda i: tuple(points[i]))


def sees_all(points, p):
    """The kernel rule by definition: the robot sees p and every site right of it, no edge of P_p in between."""
    order = sorted((i for i in range(len(points)) if tuple(points[i]) > tuple(points[p])), key=angle_about(points, p))
    ring = [points[p], *(points[i] for i in order)]
    return all(not left(b, a, ROBOT) for a, b in itertools.pairwise([*ring, ring[0]]))


def angle_about(points, p):
    return lambda i: np.arctan2(*(points[i] - points[p])[::-1])


@pytest.mark.parametrize("by_kernel", [True, False])
def test_the_search_is_exact_among_the_leftmost_vertices_that_the_rule_leaves(by_kernel):
    rng = np.random.default_rng(2)
    for _ in range(150):
        points = rng.uniform(-1.0, 1.0, (rng.integers(3, 9), 2))
        rings = [ring for ring in convex_rings(points) if is_empty_around(points, ring, ROBOT)]
        if by_kernel:
            rings = [ring for ring in rings if sees_all(points, leftmost(points, ring))]
        found = rings_around(points, by_kernel)
        assert (found[0].size if found else 0) == max(map(len, rings), default=0)
        for ring in found:
            first = ring.vertices.index(min(ring.vertices))
            assert (*ring.vertices[first:], *ring.vertices[:first]) in rings
            assert ring.vertices[0] == leftmost(points, ring.vertices)
            assert ring.area == pytest.approx(twice_area(points, tuple(ring.vertices)))
