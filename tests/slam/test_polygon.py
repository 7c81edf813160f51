"""The public search for the largest empty convex polygons, against vectors and brute force."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from mecp_env.slam.polygon import largest_empty_convex_polygons

VECTORS = json.loads((Path(__file__).parents[1] / "data" / "empty_convex_polygons.json").read_text())["vectors"]
OPEN = [vector for vector in VECTORS if vector["mode"] == "open"]


def cross(o, a, b):
    return (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0])


def twice_area(points, ring):
    return sum(cross((0, 0), points[a], points[b]) for a, b in zip(ring, ring[1:] + ring[:1], strict=True))


def all_left(points, a, b, subset):
    return all(cross(points[a], points[b], points[c]) > 0 for c in subset if c not in (a, b))


def convex_rings(points):
    """All strictly convex rings of distinct points: a subset is one if each vertex has all others left of one edge."""
    n = len(points)
    for size in range(3, n + 1):
        for subset in itertools.combinations(range(n), size):
            after = {a: b for a, b in itertools.permutations(subset, 2) if all_left(points, a, b, subset)}
            if len(after) == size:
                ring = [subset[0]]
                while len(ring) < size:
                    ring.append(after[ring[-1]])
                yield tuple(ring)


def edges(points, ring):
    return [(points[a], points[b]) for a, b in zip(ring, ring[1:] + ring[:1], strict=True)]


def contains(points, ring, robot, on_edge):
    sides = [cross(a, b, robot) for a, b in edges(points, ring)]
    return all(side >= 0 if on_edge else side > 0 for side in sides)


def brute_force(points, robot, on_edge):
    """Polygons with most vertices, sorted by ids, the slow way."""
    first = {tuple(p): i for i, p in reversed(list(enumerate(points)))}
    points = {i: p for p, i in sorted(first.items(), key=lambda item: item[1])}
    ids = list(points)
    found = []
    for ring in convex_rings([points[i] for i in ids]):
        named = tuple(ids[i] for i in ring)
        if is_empty_of(points, named) and (robot is None or contains(points, named, robot, on_edge)):
            found.append(named)
    most = max(map(len, found), default=0)
    return [ring for ring in found if len(ring) == most]


def is_empty_of(points, ring):
    return not any(all(cross(a, b, p) > 0 for a, b in edges(points, ring)) for p in points.values())


@pytest.mark.parametrize("vector", OPEN, ids=lambda vector: vector["name"])
def test_vectors_of_mode_open_hold(vector):
    found = largest_empty_convex_polygons(
        vector["points"], vector["robot"], robot_on_edge=vector["robot_on_edge"], ties="cardinality"
    )
    expected = {tuple(ring) for ring in vector["optimal"]}
    assert len(found) == len(set(found)) == vector["n_optimal"]
    assert {len(ring) for ring in found} == ({vector["expected"]} if found else set())
    assert expected <= set(found) if vector["optimal_truncated"] else expected == set(found)


@pytest.mark.parametrize("span", [2, 4, 12, 1000])
def test_brute_force_agrees_on_random_sets_with_ties_collinear_points_and_duplicates(span):
    rng = np.random.default_rng(span)
    for _ in range(350):
        points = rng.integers(0, span + 1, (rng.integers(3, 9), 2)).tolist()
        for robot, on_edge in ((None, False), ((span / 2 + 0.25, span / 2), False), (points[0], True), (None, True)):
            expected = brute_force(points, robot, on_edge)
            found = largest_empty_convex_polygons(points, robot, robot_on_edge=on_edge, ties="cardinality")
            assert sorted(found) == sorted(expected)
            largest = max((twice_area(points, ring) for ring in expected), default=0)
            best = [ring for ring in sorted(expected) if twice_area(points, ring) == largest]
            assert largest_empty_convex_polygons(points, robot, robot_on_edge=on_edge) == best
