"""Every compiled function of the polygon stage against a reference implementation."""

import itertools
import math
from functools import partial

import numpy as np
import pytest

from mecp_env.slam.config import PolygonConfig
from mecp_env.slam.mecp.cycles import best_cycles, largest_cycle, order_by_bearing, visible_edges
from mecp_env.slam.mecp.polygons import best_free_cycles, edge_between, edge_is_cut, passing_intervals
from tests.slam import make
from tests.slam.make import MIDDLES
from tests.slam.mecp.plain import allowed_rings, cross, plain_visible_edges, random_sites, twice_area

LIMITS = PolygonConfig().record[0]


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


def rings_of(found):
    """The rings of a search as tuples."""
    return [tuple(ring[:size].tolist()) for size, ring in zip(*found, strict=True) if size]


@pytest.mark.parametrize("tolerance", [0.0, 0.05, 0.4])
def test_best_cycles_are_the_best_by_definition(tolerance):
    """Those of most vertices, the larger ones first; and the largest one, however many vertices it has."""
    rng, differs = np.random.default_rng(3), 0
    for n in (*rng.integers(0, 9, 150), 11, 12):
        points = random_sites(rng, n, tolerance)
        allowed, area = visible_edges(points, tolerance), partial(twice_area, points)
        rings = sorted(allowed_rings(points, tolerance), key=area, reverse=True)
        best = [ring for ring in rings if len(ring) == max(map(len, rings))]
        found = {keep: rings_of(best_cycles(points, allowed, tolerance, keep)) for keep in (1, 4, 200)}
        largest = rings_of(largest_cycle(points, allowed, tolerance))
        assert sorted(found[200]) == sorted(best)
        for some, expected in ((largest, rings[:1]), *((found[keep], best[:keep]) for keep in found)):
            assert list(map(area, some)) == pytest.approx(list(map(area, expected)))
            assert not tolerance or some == expected  # no ties of area
        differs += largest != found[1]
    assert differs > 5


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


@pytest.mark.parametrize("by_area", [False, True])
def test_the_lazy_check_finds_what_forbidding_all_cut_edges_first_finds(by_area):
    rng, resolved = np.random.default_rng(11), 0
    for _ in range(200):
        points = random_sites(rng, rng.integers(0, 14), 0.1)
        sigmas = rng.uniform(0.002, 0.014, len(points))
        tolerance = 2.5 * (sorted(sigmas)[len(sigmas) // 2] if len(sigmas) else 0.0)  # of the upper median
        view = make.edge_beams(np.repeat(rng.uniform(0.5, 6.0, 72), 10))
        allowed = visible_edges(points, tolerance)
        free = allowed.copy()
        for i, j in np.argwhere(allowed):
            edge = edge_between(points[i], points[j], max(sigmas[i], sigmas[j]), view, LIMITS)
            free[i, j] = not edge_is_cut(edge, view, LIMITS)
        expected, unchecked = (
            largest_cycle(points, edges, tolerance) if by_area else best_cycles(points, edges, tolerance, 2)
            for edges in (free, allowed)
        )
        found = best_free_cycles(points, sigmas, view, LIMITS, by_area)
        assert rings_of(found) == rings_of(expected)
        resolved += rings_of(expected) != rings_of(unchecked)
    assert resolved > 50
