"""Every compiled function of the polygon stage against a reference implementation."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from mecp_env.slam.config import PolygonConfig
from mecp_env.slam.frontend.clustering import wall_beams
from mecp_env.slam.mecp.cycles import best_cycles, order_by_bearing, quietest_gap, visible_edges
from mecp_env.slam.mecp.edge_labels import edge_between, edge_is_cut, from_normal, passing_intervals
from mecp_env.slam.mecp.polygons import best_free_cycles
from tests.slam import make
from tests.slam.make import MIDDLES
from tests.slam.mecp.reference import largest_empty_convex_polygons
from tests.slam.mecp.test_polygons import convex_rings, edges, twice_area

LIMITS = PolygonConfig().record[0]


def random_sites(rng, n, tolerance):
    """Sites around the origin by bearing; with tolerance 0 on a coarse grid, so that rays and lines coincide."""
    points = rng.uniform(-3, 3, (n, 2)) if tolerance else np.unique(rng.integers(-3, 4, (n, 2)), axis=0) + 0.0
    points = points[(points != 0).any(axis=1)]
    return np.ascontiguousarray(points[order_by_bearing(points)])


def cross(a, b):
    return a[0] * b[1] - a[1] * b[0]


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


def off_chord(points, ring):
    """Distance of each vertex of a ring from the line through its neighbours."""
    for a, b, c in zip(ring[-1:] + ring[:-1], ring, ring[1:] + ring[:1], strict=True):
        yield cross(points[b] - points[a], points[c] - points[a]) / np.hypot(*(points[c] - points[a]))


def plain_best_rings(points, tolerance):
    """All largest polygons around the origin, by definition: larger area first."""
    allowed = plain_visible_edges(points, tolerance)
    rings = [
        ring
        for ring in convex_rings(points)
        if all(cross(a, b) > 0 for a, b in edges(points, ring))
        and all(allowed[a, b] for a, b in zip(ring, ring[1:] + ring[:1], strict=True))
        and min(off_chord(points, ring)) > tolerance
    ]
    most = max(map(len, rings), default=0)
    return sorted((r for r in rings if len(r) == most), key=lambda ring: (-twice_area(points, ring), ring))


def test_order_by_bearing_is_the_order_of_atan2_with_the_nearer_point_of_a_ray_first():
    rng = np.random.default_rng(0)
    for _ in range(200):
        points = np.unique(rng.integers(-3, 4, (12, 2)), axis=0) + 0.0
        points = rng.permutation(points[(points != 0).any(axis=1)])
        keys = [(math.atan2(y, x), math.hypot(x, y)) for x, y in points[order_by_bearing(points)]]
        assert keys == sorted(keys)


@pytest.mark.parametrize("tolerance", [0.0, 0.05, 0.4])
def test_visible_edges_are_those_whose_triangle_is_empty(tolerance):
    rng = np.random.default_rng(1)
    for _ in range(300):
        points = random_sites(rng, rng.integers(1, 10), tolerance)
        np.testing.assert_array_equal(visible_edges(points, tolerance), plain_visible_edges(points, tolerance))


def test_the_quietest_gap_is_crossed_by_the_fewest_edges():
    rng = np.random.default_rng(2)
    for _ in range(100):
        points = random_sites(rng, 10, 0.1)
        allowed = visible_edges(points, 0.1)
        n = len(points)
        crossings = [sum((gap - i - 1) % n < (j - i) % n for i, j in np.argwhere(allowed)) for gap in range(n)]
        assert crossings[quietest_gap(allowed)] == min(crossings)


@pytest.mark.parametrize("tolerance", [0.0, 0.05, 0.4])
@pytest.mark.parametrize("keep", [1, 2, 4])
def test_best_cycles_are_the_best_by_definition(tolerance, keep):
    rng = np.random.default_rng(3)
    for _ in range(80):
        points = random_sites(rng, rng.integers(3, 9), tolerance)
        sizes, rings = best_cycles(points, visible_edges(points, tolerance), tolerance, keep)
        expected = plain_best_rings(points, tolerance)[:keep]
        assert sizes.tolist() == [len(ring) for ring in expected] + [0] * (keep - len(expected))
        areas = [twice_area(points, tuple(ring[:size])) for ring, size in zip(rings, sizes, strict=True) if size]
        np.testing.assert_allclose(areas, [twice_area(points, ring) for ring in expected])
        if tolerance:  # no ties of area
            assert [tuple(r[:s]) for r, s in zip(rings, sizes, strict=True) if s] == expected


@pytest.mark.parametrize("tolerance", [0.0, 0.05, 0.4])
def test_the_reference_agrees_with_the_compiled_one_and_the_definition(tolerance):
    rng = np.random.default_rng(4)
    for _ in range(150):
        points = random_sites(rng, rng.integers(3, 9), tolerance)
        found = largest_empty_convex_polygons(points, (0, 0), tolerance=tolerance, ties="cardinality")
        assert sorted(found) == sorted(plain_best_rings(points, tolerance))


def test_more_sites_than_brute_force_can_do_agree_between_both_searches():
    rng = np.random.default_rng(5)
    for n in (12, 20, 30, 40):
        for _ in range(10):
            points = random_sites(rng, n, 0.1)
            found = largest_empty_convex_polygons(points, (0, 0), tolerance=0.02, ties="cardinality")
            sizes, rings = best_cycles(points, visible_edges(points, 0.02), 0.02, 2)
            kept = [tuple(ring[:size].tolist()) for ring, size in zip(rings, sizes, strict=True) if size]
            assert kept == found[: len(kept)]
            assert len(kept) == min(2, len(found))


def test_without_a_robot_tolerance_counts_from_the_leftmost_vertex():
    rng = np.random.default_rng(6)
    for tolerance in (0.0, 0.1, 0.5):
        for _ in range(100):
            points = rng.uniform(0, 3, (rng.integers(3, 8), 2))
            rings = [r for r in convex_rings(points) if is_empty_from_leftmost(points, r, tolerance)]
            rings = [r for r in rings if min(off_chord(points, r)) > tolerance]
            most = max(map(len, rings), default=0)
            found = largest_empty_convex_polygons(points, tolerance=tolerance, ties="cardinality")
            assert sorted(found) == sorted(r for r in rings if len(r) == most)


def is_empty_from_leftmost(points, ring, tolerance):
    """No point lies deep in the edge behind it, as seen from the leftmost vertex, nor deep in that vertex's edges."""
    start = min(range(len(ring)), key=lambda i: points[ring[i]][0])
    ring = ring[start:] + ring[:start]
    p = points[ring[0]]
    for a, b in itertools.pairwise(ring[1:]):
        a_p, b_p = points[a] - p, points[b] - p
        for s in range(len(points)):
            s_p = points[s] - p
            deep = s not in ring and blocks(s_p, a_p, b_p, tolerance)
            deep = deep and (a != ring[1] or cross(a_p, s_p) / np.hypot(*a_p) > tolerance)
            if deep and (b != ring[-1] or cross(s_p, b_p) / np.hypot(*b_p) > tolerance):
                return False
    return True


def test_the_polynomial_is_the_cosine():
    for x in np.linspace(-np.pi / 2, np.pi / 2, 501):
        for turns in (-1, 0, 1):
            angle, cosine = from_normal(1.0 + x, 1.0 + turns * 2.0 * math.pi)
            assert angle == pytest.approx(x)
            assert abs(cosine - math.cos(x)) < 1e-10


def edge_of(a, b, tolerance, beams):
    """The edge from a to b, which may be off by `tolerance` (m)."""
    return edge_between(a, b, tolerance / LIMITS["tolerance_sigmas"], beams, LIMITS)


def random_edge(rng):
    """Two points less than 180 degrees apart as seen from the origin, ccw."""
    start, span = rng.uniform(-np.pi, np.pi), rng.uniform(0.01, 3.0)
    angle, distance = np.array([start, start + span]), rng.uniform(0.5, 6.0, 2)
    return distance[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def beams_of_edge(a, b):
    """Indices of the beams between a and b in order, and where along each beam the edge stands."""
    start = np.arctan2(a[1], a[0])
    after = np.mod(MIDDLES - start, 2 * np.pi)
    span = np.mod(np.arctan2(b[1], b[0]) - start, 2 * np.pi)
    beams = np.flatnonzero((after < span) & (after > 0))
    beams = beams[np.argsort(after[beams])]
    u = np.column_stack([np.cos(MIDDLES[beams]), np.sin(MIDDLES[beams])])
    d = (b - a) / np.hypot(*(b - a))
    return beams, u, cross(a, d) / (u[:, 0] * d[1] - u[:, 1] * d[0])


def across(a, b, hits, stands):
    """How far hits lie beyond the edge across it, less half a beam spacing at the edge (never below 0)."""
    d = (b - a) / np.hypot(*(b - a))
    off = (hits - a) @ np.array([d[1], -d[0]])
    return np.sign(off) * np.maximum(np.abs(off) - 0.5 * 2 * np.pi / 720 * stands, 0.0)


def random_view(rng, a, b):
    """Beams that stop at, fall short of or pass the edge in runs of random length."""
    ranges = rng.uniform(0.5, 8.0, 720)
    beams, _, stands = beams_of_edge(a, b)
    offsets = np.repeat(rng.choice([-0.5, -0.19, 0.0, 0.02, 0.5, 3.0], 720), rng.integers(1, 40, 720))[: len(beams)]
    ranges[beams] = np.maximum(stands + offsets, 0.05)
    return make.edge_beams(ranges, rng.random(720) < 0.9)


def test_beams_between_two_bearings_are_counted_around_the_end():
    rng = np.random.default_rng(7)
    for _ in range(500):
        a, b = random_edge(rng)
        edge = edge_of(a, b, 0.0, make.edge_beams(1.0))
        assert [(edge.first + step) % 720 for step in range(edge.beams)] == beams_of_edge(a, b)[0].tolist()


@pytest.mark.parametrize("tolerance", [0.0, 0.05])
def test_an_edge_is_cut_when_three_neighbours_end_on_a_wall_in_front_of_it(tolerance):
    rng = np.random.default_rng(8)
    cuts = 0
    for _ in range(600):
        a, b = random_edge(rng)
        view = random_view(rng, a, b)
        beams, u, stands = beams_of_edge(a, b)
        short = (view.ranges[beams] + 0.2 < stands) & view.wall[beams]
        short &= across(a, b, view.ranges[beams, None] * u, stands) < -tolerance
        expected = any(short[i : i + 3].all() for i in range(len(short) - 2))
        assert edge_is_cut(edge_of(a, b, tolerance, view), view, LIMITS) == expected
        cuts += expected
    assert 100 < cuts < 500


@pytest.mark.parametrize("tolerance", [0.0, 0.05])
def test_passing_intervals_are_the_runs_of_beams_that_go_on_beyond_the_edge(tolerance):
    rng = np.random.default_rng(9)
    found = 0
    for _ in range(600):
        a, b = random_edge(rng)
        view = random_view(rng, a, b)
        expected = plain_intervals(a, b, tolerance, view)
        found_here = passing_intervals(edge_of(a, b, tolerance, view), view, LIMITS)
        np.testing.assert_allclose(found_here, expected, atol=1e-6)
        found += len(expected)
    assert found > 200


def plain_intervals(a, b, tolerance, view):
    beams, u, stands = beams_of_edge(a, b)
    ranges = view.ranges[beams]
    passes = (ranges - 0.2 > stands) & (across(a, b, ranges[:, None] * u, stands) > tolerance)
    told = ranges + 0.2 >= stands
    bearing, passes = np.unwrap(MIDDLES[beams])[told], passes[told]
    d = (b - a) / np.hypot(*(b - a))
    middle = 0.5 * (bearing[1:] + bearing[:-1])
    along = cross(a, d) / (np.cos(middle) * d[1] - np.sin(middle) * d[0])
    along = along[:, None] * np.column_stack([np.cos(middle), np.sin(middle)]) @ d - a @ d
    intervals = []
    for value, run in itertools.groupby(range(len(passes)), key=lambda i: passes[i]):
        run = list(run)
        begin = 0.0 if run[0] == 0 else along[run[0] - 1]
        end = np.hypot(*(b - a)) if run[-1] == len(passes) - 1 else along[run[-1]]
        if value and end - begin >= 0.2:
            intervals.append((begin, end))
    return np.array(intervals).reshape(-1, 2)


def test_wall_beams_are_those_of_clusters_with_lines():
    runs = 5, np.array([0, 4, 8]), np.array([2, 7, 9]), np.array([0, 1, 0])
    assert np.flatnonzero(wall_beams(*runs, 12)).tolist() == [1, 2, 5, 6, 7]


def test_the_lazy_check_finds_what_forbidding_all_cut_edges_first_finds():
    rng = np.random.default_rng(11)
    resolved = 0
    for _ in range(300):
        points = random_sites(rng, rng.integers(0, 14), 0.1)
        sigmas = rng.uniform(0.002, 0.014, len(points))
        tolerance = 2.5 * (sorted(sigmas)[len(sigmas) // 2] if len(sigmas) else 0.0)  # of the upper median
        view = make.edge_beams(np.repeat(rng.uniform(0.5, 6.0, 72), 10))
        allowed = visible_edges(points, tolerance)
        free = allowed.copy()
        for i, j in np.argwhere(allowed):
            edge = edge_between(points[i], points[j], max(sigmas[i], sigmas[j]), view, LIMITS)
            free[i, j] = not edge_is_cut(edge, view, LIMITS)
        expected = best_cycles(points, free, tolerance, 2)
        found = best_free_cycles(points, sigmas, view, LIMITS, False)
        np.testing.assert_array_equal(found[0], expected[0])
        np.testing.assert_array_equal(found[1], expected[1])
        resolved += not np.array_equal(expected[1], best_cycles(points, allowed, tolerance, 2)[1])
    assert resolved > 100
