"""The structure `largest_area`: exact against brute force and a plain twin, by its name, and custom structures."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np
import pytest

from benchmarks.polygon_speed import scans_of
from mecp_env.core.errors import ConfigError
from mecp_env.core.se2 import polar_to_points
from mecp_env.slam import config
from mecp_env.slam.config import PolygonConfig, SlamConfig
from mecp_env.slam.mecp import STRUCTURES, find_structure, register_structure
from mecp_env.slam.mecp.cycles import best_cycles, largest_cycle, visible_edges
from mecp_env.slam.mecp.edge_labels import edge_between, edge_is_cut
from mecp_env.slam.mecp.polygons import best_free_cycles
from mecp_env.slam.messages import Polygon
from mecp_env.slam.pipeline import SlamPipeline
from tests.slam import make
from tests.slam.drives import scripted_drive
from tests.slam.mecp.polygon_rooms import beams_of, corners_of, sees
from tests.slam.mecp.test_cycles import LIMITS, off_chord, plain_visible_edges, random_sites
from tests.slam.mecp.test_polygon_scan import ring_of, rooms
from tests.slam.mecp.test_polygons import convex_rings, edges, twice_area

AREA = PolygonConfig(structure="largest_area")


def cross(a, b):
    return a[0] * b[1] - a[1] * b[0]


def plain_areas(points, tolerance):
    """Twice the area of every allowed polygon around the origin, by definition, largest first."""
    allowed = plain_visible_edges(points, tolerance)
    rings = [
        ring
        for ring in convex_rings(points)
        if all(cross(a, b) > 0 for a, b in edges(points, ring))
        and all(allowed[a, b] for a, b in zip(ring, ring[1:] + ring[:1], strict=True))
        and min(off_chord(points, ring)) > tolerance
    ]
    return sorted(((twice_area(points, ring), ring) for ring in rings), reverse=True)


def is_strict(points, a, b, c, tolerance):
    """True when b is a vertex between a and c."""
    turn = cross(points[b] - points[a], points[c] - points[b])
    return turn > 0 and turn > tolerance * math.hypot(*(points[c] - points[a]))


def twin(points, allowed, tolerance):
    """Twice the largest area, by the recursion over pairs of vertices: for each first edge, whatever ray it crosses."""
    n, best = len(points), 0.0
    for head, second in np.argwhere(allowed):
        turn = [cross(points[head], p) for p in points]  # bearings from the head on, over half a turn and more
        order = sorted(range(n), key=lambda k: angle_from(points[head], points[k]))
        place = {k: i for i, k in enumerate(order)}
        most = {(head, second): turn[second]}
        for b in order[place[second] :]:
            into = [(a, area) for (a, to), area in most.items() if to == b]
            for a, area in into:
                closes = allowed[b, head] and is_strict(points, a, b, head, tolerance)
                if closes and is_strict(points, b, head, second, tolerance):
                    best = max(best, area + cross(points[b], points[head]))
                for c in order[place[b] + 1 :]:
                    if allowed[b, c] and is_strict(points, a, b, c, tolerance):
                        most[b, c] = max(most.get((b, c), 0.0), area + cross(points[b], points[c]))
    return best


def angle_from(a, b):
    """Bearing of b about the origin, from that of a, in [0, 2 pi)."""
    return math.atan2(cross(a, b), a[0] * b[0] + a[1] * b[1]) % (2 * math.pi)


def area_of(points, sizes, rings):
    return twice_area(points, tuple(rings[0][: sizes[0]])) if sizes[0] else 0.0


@pytest.mark.parametrize("tolerance", [0.0, 0.05, 0.4])
def test_the_largest_cycle_is_the_largest_by_definition(tolerance):
    rng, differs = np.random.default_rng(3), 0
    for _ in range(150):
        points = random_sites(rng, rng.integers(0, 9), tolerance)
        allowed = visible_edges(points, tolerance)
        sizes, rings = largest_cycle(points, allowed, tolerance)
        expected = plain_areas(points, tolerance)
        assert (sizes[0] > 0) == bool(expected)
        assert area_of(points, sizes, rings) == pytest.approx(expected[0][0] if expected else 0.0)
        if tolerance and expected:  # no ties of area
            assert tuple(rings[0][: sizes[0]]) == expected[0][1]
            differs += sizes[0] < best_cycles(points, allowed, tolerance, 1)[0][0]
    assert not tolerance or differs > 5


def test_more_sites_than_brute_force_can_do_agree_with_the_twin():
    rng = np.random.default_rng(5)
    for n, _ in itertools.product((10, 14, 20), range(6)):
        points = random_sites(rng, n, 0.1)
        allowed = visible_edges(points, 0.02)
        found = area_of(points, *largest_cycle(points, allowed, 0.02))
        assert found == pytest.approx(twin(points, allowed, 0.02))
        assert found >= area_of(points, *best_cycles(points, allowed, 0.02, 1)) - 1e-9


def test_the_twin_agrees_with_the_definition():
    rng = np.random.default_rng(6)
    for tolerance in (0.0, 0.05, 0.4):
        for _ in range(40):
            points = random_sites(rng, rng.integers(3, 8), tolerance)
            expected = plain_areas(points, tolerance)
            assert twin(points, visible_edges(points, tolerance), tolerance) == pytest.approx(
                expected[0][0] if expected else 0.0
            )


def test_the_lazy_check_finds_what_forbidding_all_cut_edges_first_finds():
    rng, resolved = np.random.default_rng(11), 0
    for _ in range(200):
        points = random_sites(rng, rng.integers(0, 14), 0.1)
        sigmas = np.full(len(points), 0.008)
        view = make.edge_beams(np.repeat(rng.uniform(0.5, 6.0, 72), 10))
        allowed = visible_edges(points, 0.02)
        free = allowed.copy()
        for i, j in np.argwhere(allowed):
            free[i, j] = not edge_is_cut(edge_between(points[i], points[j], 0.008, view, LIMITS), view, LIMITS)
        expected = largest_cycle(points, free, 0.02)
        found = best_free_cycles(points, sigmas, view, LIMITS, True)
        np.testing.assert_array_equal(found[0], expected[0])
        np.testing.assert_array_equal(found[1], expected[1])
        resolved += not np.array_equal(expected[1], largest_cycle(points, allowed, 0.02)[1])
    assert resolved > 50


def test_in_a_bare_room_it_is_the_mecp():
    for _, walls, points, poses in rooms():
        for pose in poses[:25]:
            corners, beams = corners_of(points[sees(walls, pose[:2], points)], pose), beams_of(walls, pose)
            mecp, largest = (find_structure(corners, beams, c) for c in (PolygonConfig(), AREA))
            assert len(largest) == min(len(mecp), 1)
            if mecp:
                rings = [ring_of(found[0], corners, pose) for found in (mecp, largest)]
                most, area = (twice_area(ring, tuple(range(len(ring)))) for ring in rings)
                assert len(rings[0]) == len(rings[1])
                assert area == pytest.approx(most)


def test_among_furniture_it_covers_more_floor_with_fewer_vertices():
    larger = 0
    for corners, beams, wall in scans_of("furnished", 80):
        mecp, largest = (find_structure(corners, beams, c, wall) for c in (PolygonConfig(), AREA))
        assert len(largest) == min(len(mecp), 1)
        if mecp and len(largest[0].corners) >= 4:  # a triangle is searched for again, among jambs too
            points = polar_to_points(corners.z)
            most, area = (twice_area(points, tuple(found[0].corners)) for found in (mecp, largest))
            assert area >= most - 1e-9
            assert len(mecp[0].corners) >= len(largest[0].corners)
            larger += area > most + 1e-9
    assert larger > 5


def test_a_configuration_selects_it_by_name():
    drive, pipeline = scripted_drive(), SlamPipeline({"polygon": {"structure": "largest_area"}})
    outputs = [pipeline.start(drive.scans[0])]
    outputs += [pipeline.step(drive.odometry[k], drive.scans[k]) for k in range(3, 30)]
    assert {len(output.polygons) for output in outputs} <= {0, 1}
    assert sum(bool(output.match.polygon >= 0) for output in outputs) > 10


@pytest.fixture
def names() -> Iterator[None]:
    yield
    for name in config.STRUCTURE_NAMES.others:
        del STRUCTURES[name]
    config.STRUCTURE_NAMES.others.clear()


def without(corners, beams, polygon, wall) -> tuple[Polygon, ...]:
    return ()


def test_a_custom_structure_is_registered_by_name(names):
    with pytest.raises(ConfigError, match=r"polygon\.structure: .*'mecp', 'largest_area' or 'dobkin'"):
        SlamConfig(polygon={"structure": "none"})
    register_structure("none", without)
    drive, pipeline = scripted_drive(), SlamPipeline({"polygon": {"structure": "none"}})
    assert pipeline.start(drive.scans[0]).polygons == ()
    with pytest.raises(ConfigError, match=r"name: 'mecp' is one of ours \(mecp, largest_area, dobkin\)"):
        register_structure("mecp", without)
