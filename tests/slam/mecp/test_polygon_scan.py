"""The polygons of a scan: the claims of the paper, the wall-crossing check, and the edge intervals."""

import numpy as np
import pytest

from mecp_env.core.se2 import polar_to_points, to_map
from mecp_env.slam.config import PolygonConfig
from mecp_env.slam.mecp.polygons import find_polygons
from mecp_env.slam.messages import CornerKind, EdgeLabel
from tests.slam import make
from tests.slam.frontend.make import on_walls
from tests.slam.mecp.plain import twice_area
from tests.slam.mecp.polygon_rooms import BOX, ROOMS, beams_of, corners_of, poses_in, sees, wall_inside, walls_of

CONFIG = PolygonConfig()
UNCHECKED = PolygonConfig(check_walls=False)
RECTANGLE = np.array(ROOMS["rectangle"], float)


def rooms():
    """Name, faces, corners, poses of each room, one of them with a box in it."""
    for name, ring in ROOMS.items():
        yield name, walls_of(ring), np.array(ring, float), poses_in(ring, 25, np.random.default_rng(len(ring)))
    ring = ROOMS["rectangle"]
    poses = poses_in(ring, 25, np.random.default_rng(9), holes=(BOX,))
    yield "box", walls_of(ring, BOX), np.array([*ring, *BOX], float), poses


def room_with_door():
    """A 6 x 4 m room, wall 0.15 m, a door of 0.9 m in its right wall into a second room: faces and jambs."""
    inner = [(6, 0), (6, 1.5), (6.15, 1.5), (6.15, 0), (10, 0), (10, 4), (6.15, 4), (6.15, 2.4), (6, 2.4), (6, 4)]
    return walls_of([(0, 0), *inner, (0, 4)]), np.array([(6.0, 1.5), (6.0, 2.4)])


def ring_of(polygon, corners, pose):
    return to_map(pose, polar_to_points(corners.z[polygon.corners]))


@pytest.mark.parametrize(
    ("name", "walls", "points", "poses"), list(rooms()), ids=lambda value: value if isinstance(value, str) else ""
)
def test_no_wall_crosses_a_polygon_whose_sites_are_all_visible_corners(name, walls, points, poses):
    """The theorem of derivations 1.5, without the wall-crossing check, which then changes nothing."""
    rng = np.random.default_rng(5)
    for pose in poses:
        corners, beams = corners_of(points[sees(walls, pose[:2], points)], pose), beams_of(walls, pose)
        polygons = find_polygons(corners, beams, UNCHECKED)
        assert polygons
        for polygon in polygons:
            ring = ring_of(polygon, corners, pose)
            assert wall_inside(walls, ring) < 0.02
            assert twice_area(ring, tuple(range(len(ring)))) > 0.0
            assert polygon.corners[0] == polygon.corners.min()
        checked = find_polygons(corners, beams, CONFIG)
        assert [p.corners.tolist() for p in polygons] == [p.corners.tolist() for p in checked]
        for polygon in find_polygons(corners, beams_of(walls, pose, rng, 0.02), CONFIG):
            for edge in range(len(polygon.corners)):  # its intervals cover it without overlap
                rows = polygon.intervals[polygon.intervals[:, 0] == edge]
                assert (rows[0, 1], rows[-1, 2]) == (0.0, 1.0)
                np.testing.assert_array_equal(rows[1:, 1], rows[:-1, 2])
                assert (rows[:, 2] > rows[:, 1]).all()


def test_the_wall_crossing_check_keeps_walls_out_where_corners_were_missed():
    rng = np.random.default_rng(3)
    crossed = 0
    for name in ("L", "T", "Z", "cross"):
        walls, points = walls_of(ROOMS[name]), np.array(ROOMS[name], float)
        for pose in poses_in(ROOMS[name], 60, rng):
            seen = sees(walls, pose[:2], points) & (rng.random(len(points)) > 0.2)
            corners, beams = corners_of(points[seen], pose), beams_of(walls, pose)
            for polygon in find_polygons(corners, beams, UNCHECKED):
                crossed += wall_inside(walls, ring_of(polygon, corners, pose)) > 0.3
            for polygon in find_polygons(corners, beams, CONFIG):
                assert wall_inside(walls, ring_of(polygon, corners, pose)) < 0.3
    assert crossed > 10


def test_a_pillar_is_no_wall_and_does_not_kill_the_rooms_polygon():
    pillar = [(2.0 + 0.2 * np.cos(t), 2.0 + 0.2 * np.sin(t)) for t in np.linspace(0, 2 * np.pi, 16, endpoint=False)]
    walls, pose = walls_of(ROOMS["rectangle"], pillar[::-1]), np.array([2.6, 2.0, 0.4])
    corners, beams = corners_of(RECTANGLE, pose), beams_of(walls, pose)
    p_world = to_map(pose, polar_to_points(np.column_stack([beams.ranges, beams.bearings])))
    wall = np.hypot(*(p_world - (2.0, 2.0)).T) > 0.25
    (polygon,) = find_polygons(corners, beams, CONFIG, wall)
    assert len(polygon.corners) == 4
    assert polygon.intervals[:, 3].tolist() == [EdgeLabel.WALL] * 4
    assert find_polygons(corners, beams, CONFIG) == ()  # every beam taken for a wall's


def test_beams_on_walls_are_those_of_clusters_with_lines():
    clusters = make.clusters([0, 10], [5, 12], [0, 1], roll=718)
    beams = beams_of(walls_of(RECTANGLE), np.array([1.0, 1.0, 0.0]))
    assert np.flatnonzero(on_walls(clusters, beams)).tolist() == [0, 1, 2, 3, 718, 719]


@pytest.mark.parametrize("detected", [True, False])
def test_a_wall_with_a_door_is_wall_gap_wall(detected):
    walls, jambs = room_with_door()
    pose = np.array([3.0, 2.0, 2.9])
    kinds = [CornerKind.CROSSING] * 4 + [CornerKind.JAMB] * 2
    corners = corners_of([*RECTANGLE, *jambs], pose, kinds=kinds, doors=[(4, 5)] if detected else [])
    (polygon,) = find_polygons(corners, beams_of(walls, pose), CONFIG)
    ring = ring_of(polygon, corners, pose)
    (edge,) = [e for e in range(4) if np.allclose(ring[e], (6, 0)) and np.allclose(ring[(e + 1) % 4], (6, 4))]
    rows = polygon.intervals[polygon.intervals[:, 0] == edge]
    assert rows[:, 3].tolist() == [EdgeLabel.WALL, EdgeLabel.GAP, EdgeLabel.WALL]
    np.testing.assert_allclose(rows[:, 1:3] * 4.0, [[0, 1.5], [1.5, 2.4], [2.4, 4]], atol=0.06)
    others = polygon.intervals[polygon.intervals[:, 0] != edge]
    assert (others[:, 3] == EdgeLabel.WALL).all()


def test_an_edge_across_free_space_is_open_and_the_goal_beyond_it_free():
    walls, points = walls_of(ROOMS["L"]), np.array(ROOMS["L"], float)
    pose = np.array([1.8, 1.0, -2.0])
    corners = corners_of(points, pose)
    (polygon,) = find_polygons(corners, beams_of(walls, pose), CONFIG)
    ring = ring_of(polygon, corners, pose)
    ((edge, start, end, _),) = polygon.intervals[polygon.intervals[:, 3] != EdgeLabel.WALL]
    a, b = ring[int(edge)], ring[(int(edge) + 1) % len(ring)]
    assert polygon.intervals[:, 3].max() == EdgeLabel.OPEN
    assert (end - start) * np.hypot(*(b - a)) > 3.5
    outward = np.array([b[1] - a[1], a[0] - b[0]]) / np.hypot(*(b - a))
    goal = a + 0.5 * (start + end) * (b - a) + 0.4 * outward
    assert sees(walls, pose[:2], goal[None]).all()


def test_of_equally_many_vertices_the_two_largest_polygons_are_kept():
    walls, points = walls_of(ROOMS["cross"]), np.array(ROOMS["cross"], float)
    pose = np.array([3.1, 2.9, 0.3])
    corners, beams = corners_of(points, pose), beams_of(walls, pose)
    two = find_polygons(corners, beams, CONFIG)
    four = find_polygons(corners, beams, PolygonConfig(keep_ties=4))
    assert [p.corners.tolist() for p in two] == [p.corners.tolist() for p in four[:2]]
    areas = [twice_area(polar_to_points(corners.z), tuple(p.corners)) for p in four]
    assert len(areas) == 4
    assert (np.diff(areas) < 1e-9).all()
    assert {len(p.corners) for p in four} == {4}


def test_jambs_of_this_side_are_vertices_only_where_there_is_no_polygon_of_four_without():
    hall = np.array([(0.0, 0.0), (5.0, 0.0), (5.0, 2.0), (0.0, 2.0)])
    walls, pose = walls_of(hall), np.array([2.5, 1.0, 0.1])
    beams = beams_of(walls, pose)
    kinds = [CornerKind.CROSSING] * 2 + [CornerKind.JAMB] * 2
    corners = corners_of(hall, pose, kinds=kinds)
    (polygon,) = find_polygons(corners, beams, CONFIG)
    assert len(polygon.corners) == 4
    assert find_polygons(corners, beams, CONFIG.model_copy(update={"sites": "corners"})) == ()  # the paper's
    corners.beyond[corners.kind == CornerKind.JAMB] = 0  # now they belong to the other side
    assert find_polygons(corners, beams, CONFIG) == ()
    with_all = corners_of([*hall, (2.5, -0.2)], pose, kinds=[CornerKind.CROSSING] * 4 + [CornerKind.JAMB])
    (polygon,) = find_polygons(with_all, beams, CONFIG)
    assert (with_all.kind[polygon.corners] == CornerKind.CROSSING).all()
