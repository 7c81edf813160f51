"""The reference search for the largest empty convex polygons, against vectors and brute force."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest

from mecp_env.core.errors import ConfigError, MecpError
from tests.slam.mecp.reference import largest_empty_convex_polygons

VECTORS = json.loads((Path(__file__).parents[2] / "data" / "empty_convex_polygons.json").read_text())["vectors"]
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


def empty_rings(points):
    """All empty convex polygons, by brute force."""
    first = {tuple(p): i for i, p in reversed(list(enumerate(points)))}
    points = {i: p for p, i in sorted(first.items(), key=lambda item: item[1])}
    ids = list(points)
    named = (tuple(ids[i] for i in ring) for ring in convex_rings([points[i] for i in ids]))
    return [ring for ring in named if is_empty_of(points, ring)]


def largest_around(points, rings, robot, on_edge):
    """Those of `rings` around the robot with most vertices."""
    found = [ring for ring in rings if robot is None or contains(points, ring, robot, on_edge)]
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
    for _ in range(160):
        points = rng.integers(0, span + 1, (rng.integers(3, 9), 2)).tolist()
        rings = empty_rings(points)
        for robot, on_edge in ((None, False), ((span / 2 + 0.25, span / 2), False), (points[0], True), (None, True)):
            expected = largest_around(points, rings, robot, on_edge)
            found = largest_empty_convex_polygons(points, robot, robot_on_edge=on_edge, ties="cardinality")
            assert sorted(found) == sorted(expected)
            largest = max((twice_area(points, ring) for ring in expected), default=0)
            best = [ring for ring in sorted(expected) if twice_area(points, ring) == largest]
            assert largest_empty_convex_polygons(points, robot, robot_on_edge=on_edge) == best


@pytest.mark.parametrize("points", [[], [(0, 0)], [(0, 0), (1, 1)], [(0, 0), (1, 1), (5, 5)], [(0, 0)] * 4])
def test_no_polygon_is_an_empty_list(points):
    assert largest_empty_convex_polygons(points) == []
    assert largest_empty_convex_polygons(points, (0.5, 0.25)) == []


def test_a_robot_on_a_point_or_outside_has_no_polygon():
    square = [(0, 0), (2, 0), (2, 2), (0, 2), (1, 1)]
    assert largest_empty_convex_polygons(square, (1, 1)) == []
    assert largest_empty_convex_polygons(square, (3, 1)) == []
    assert largest_empty_convex_polygons(square[:4], (1, 1)) == [(0, 1, 2, 3)]


def test_equal_areas_all_come_back_in_order_of_ids_and_larger_areas_first():
    cross_shaped = [(0, 3), (3, 0), (6, 3), (3, 6), (3, 3)]
    triangles = largest_empty_convex_polygons(cross_shaped)
    assert triangles == sorted(triangles)
    assert len({twice_area(cross_shaped, ring) for ring in triangles}) == 1
    everything = largest_empty_convex_polygons([(0, 0), (4, 0), (4, 3), (0, 3), (6, 1)], ties="cardinality")
    areas = [twice_area([(0, 0), (4, 0), (4, 3), (0, 3), (6, 1)], ring) for ring in everything]
    assert areas == sorted(areas, reverse=True)


@pytest.mark.parametrize("turn", np.linspace(0.0, 2 * np.pi, 13))
def test_a_room_may_be_turned(turn):
    c, s = math.cos(turn), math.sin(turn)
    room = np.array([(0, 0), (7, 0), (7, 3), (3, 3), (3, 6), (0, 6)]) @ np.array([[c, s], [-s, c]])
    robot = np.array([1.0, 1.5]) @ np.array([[c, s], [-s, c]])
    best = largest_empty_convex_polygons(room, robot, tolerance=0.01)
    assert best == [(0, 3, 4, 5)] or best == [(0, 1, 2, 3)]
    assert best == largest_empty_convex_polygons(room, robot, robot_on_edge=True, tolerance=0.01)


def test_tolerance_drops_a_vertex_on_a_wall_and_ignores_a_point_just_inside():
    room = [(0, 0), (6, 0), (6, 4), (0, 4)]
    for depth in (-0.03, 0.03):
        points = [*room, (3, depth)]
        assert largest_empty_convex_polygons(points, (3, 2), tolerance=0.05) == [(0, 1, 2, 3)]
        assert largest_empty_convex_polygons(points, tolerance=0.05) == [(0, 1, 2, 3)]
    assert largest_empty_convex_polygons([*room, (3, -0.03)], (3, 2)) == [(0, 4, 1, 2, 3)]


@pytest.mark.parametrize(
    ("arguments", "options", "named"),
    [
        (([(0, 0, 0)],), {}, "points"),
        (([0, 1, 2],), {}, "points"),
        (("corner",), {}, "points"),
        (([(0, 0), (1, math.nan)],), {}, "points"),
        (([(0, 0), (1, math.inf)],), {}, "points"),
        (([(0, 0)], (1, 2, 3)), {}, "robot"),
        (([(0, 0)], (1, math.nan)), {}, "robot"),
        (([(0, 0)], "here"), {}, "robot"),
        (([(0, 0)],), {"tolerance": -0.1}, "tolerance"),
        (([(0, 0)],), {"tolerance": math.nan}, "tolerance"),
        (([(0, 0)],), {"tolerance": "wide"}, "tolerance"),
        (([(0, 0)],), {"ties": "all"}, "ties"),
    ],
)
def test_wrong_input_is_refused_by_name(arguments, options, named):
    with pytest.raises(MecpError, match=named):
        largest_empty_convex_polygons(*arguments, **options)
    if named in ("tolerance", "ties"):
        with pytest.raises(ConfigError, match=named):
            largest_empty_convex_polygons(*arguments, **options)


def test_the_points_given_are_not_written_to():
    points = np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)])
    before = points.copy()
    largest_empty_convex_polygons(points, (1, 1))
    np.testing.assert_array_equal(points, before)


@pytest.mark.parametrize("scale", [1e-200, 1e-9, 1.0, 1e9, 1e200])
def test_the_unit_of_length_does_not_matter(scale):
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * scale
    assert largest_empty_convex_polygons(square, square.mean(axis=0)) == [(0, 1, 2, 3)]
    assert largest_empty_convex_polygons(square, tolerance=0.1 * scale) == [(0, 1, 2, 3)]


def test_complex_coordinates_are_refused():
    with pytest.raises(MecpError, match="points: complex"):
        largest_empty_convex_polygons(np.array([[0, 0], [1, 0], [1j, 1]]))
