"""The outline: faces, corners, jambs, rooms and doors of the true building."""

import math

import numpy as np
import pytest
import shapely
from shapely.geometry import Point

from mecp_env.core.errors import LayoutError
from mecp_env.world.layout import Layout
from mecp_env.world.outline import Outline, build_outline, random_free_pose
from tests.world.make import jambs_of

HALF = 0.06  # half the thickness of an inner wall
OUTER = 0.075


def built(
    walls: list[object], obstacles: list[object] | None = None, start: tuple[float, float] = (1.0, 1.0)
) -> Outline:
    """One room of 6 x 4 m with some more walls and obstacles; the checks of layouts are left out."""
    ring = [(0, 0), (6, 0), (6, 4), (0, 4)]
    return build_outline(
        Layout(
            name="test",
            walls=[{"points": [*ring, (0, 0)]}, *walls],
            rooms=[{"name": "room", "polygon": ring}],
            obstacles=obstacles or [],
            starts=[{"point": start}],
        )
    )


def test_two_rooms_by_hand(two_rooms: Outline) -> None:
    west, east, corners = 5.0 - HALF, 5.0 + HALF, two_rooms.corners
    expected = sorted((x, y) for x in (OUTER, west, east, 9.0 - OUTER) for y in (OUTER, 5.0 - OUTER))
    jambs = sorted((x, y) for x in (west, east) for y in (1.35, 2.25))
    for points, convex in ((expected, False), (jambs, True)):
        found = corners.p_world[corners.convex == convex].round(9)
        assert np.array(sorted(map(tuple, found))) == pytest.approx(np.array(points))
    assert np.array_equal(corners.convex, jambs_of(two_rooms)[0])
    south_west = int(np.argmin(corners.p_world.sum(axis=1)))
    assert corners.normals[south_west] == pytest.approx([0.0, math.pi / 2.0])  # west wall first, then the south wall
    assert corners.faces[south_west] == pytest.approx([5.0 - 2 * OUTER, 5.0 - OUTER - HALF])
    jamb = int(np.argmin(np.linalg.norm(corners.p_world - (5.0 - HALF, 1.35), axis=1)))
    assert corners.normals[jamb] == pytest.approx([math.pi, math.pi / 2.0])  # along the wall, then through the door
    assert corners.faces[jamb] == pytest.approx([1.35 - OUTER, 2 * HALF])
    points = np.array([(1.0, 1.0), (8.0, 1.0), (12.0, 1.0), (-3.0, 2.0)])
    assert two_rooms.room_at(points).tolist() == [0, 1, -1, -1]


def test_faces_enclose_the_free_area_on_their_left(outline: Outline) -> None:
    starts, ends = outline.segments.swapaxes(0, 1)
    assert sorted(map(tuple, starts)) == sorted(map(tuple, ends))
    assert 0.5 * np.linalg.det(outline.segments).sum() == pytest.approx(outline.free_area.area, abs=1e-6)
    assert shapely.covers(outline.free_area.boundary.buffer(1e-6), shapely.linestrings(outline.segments)).all()


def test_corners_belong_to_rooms_and_doors(outline: Outline) -> None:
    """Separable: faces are 0.35 m or longer, but for those through doors, as long as the wall is thick."""
    corners, doors, jambs = outline.corners, outline.doors, jambs_of(outline)
    jamb = jambs.any(axis=0)
    assert np.all(corners.faces[jamb].min(axis=1) <= 0.15 + 1e-9)
    assert corners.faces[~jamb].min() >= 0.35
    assert corners.faces[jamb].max(axis=1).min() >= 0.35
    assert jambs.sum(axis=1).tolist() == [4] * len(doors)
    ahead = 0.4 * np.column_stack([np.cos(doors.normal), np.sin(doors.normal)])
    beside = [outline.room_at(doors.centre + side * ahead) for side in (-1.0, 1.0)]
    assert np.array_equal(np.transpose(beside), doors.rooms)  # from the first one to the second
    for index in range(len(doors)):
        assert set(outline.room_at(corners.p_world[jambs[index]])) == set(doors.rooms[index])
        assert np.linalg.norm(corners.p_world[jambs[index]] - doors.centre[index], axis=1) == pytest.approx(
            math.hypot(doors.width[index] / 2.0, doors.thickness[index] / 2.0)
        )


def test_collinear_walls_are_one_face() -> None:
    outline = built([{"points": [(6, 2), (6.05, 2)]}, {"points": [(0, 0), (3, 0)]}, {"points": [(2, 0), (6, 0)]}])
    assert len(outline.segments) == len(outline.corners) == 4


def test_a_pillar_has_faces_but_no_corners() -> None:
    outline = built([], [{"kind": "round", "centre": [3, 2], "radius_m": 0.3}])
    assert (outline.round.sum(), len(outline.corners)) == (32, 4)
    assert 5.88 * 3.88 - outline.free_area.area == pytest.approx(math.pi * 0.09, rel=0.01)


def test_a_slanted_wall_makes_obtuse_corners() -> None:
    outline = built([{"points": [(4, 0), (6, 2)]}])
    turns = np.degrees(np.diff(outline.corners.normals, axis=1)).ravel() % 360.0
    assert sorted(turns.round(6)) == [45.0, 45.0, 90.0, 90.0, 90.0]
    assert not outline.corners.convex.any()


def test_what_cannot_be_reached_is_left_out() -> None:
    outline = built([{"points": [(2, 0), (2, 4)]}], start=(4.0, 2.0))
    assert outline.corners.p_world[:, 0].min() == pytest.approx(2.06)


def test_random_poses_keep_their_clearance(outline: Outline) -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        x, y, heading = random_free_pose(outline, rng, 0.3)
        assert outline.free_area.contains(Point(x, y))
        assert outline.free_area.boundary.distance(Point(x, y)) >= 0.299
        assert -math.pi <= heading <= math.pi
    with pytest.raises(LayoutError, match="clearance_m"):
        random_free_pose(outline, rng, 50.0)
