"""Dynamic objects are not landmarks: hits on floor seen free, landmarks seen through, walls that continue."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mecp_env.slam.config import DynamicObjectsConfig, SlamConfig
from mecp_env.slam.landmark_map.dynamic_objects import (
    StaticWorld,
    make_dynamic_objects,
    whole_bodies,
    without_dynamic,
)
from mecp_env.slam.landmark_map.tracks import PruneLimits, find_pruned
from mecp_env.slam.messages import Decision, Reason
from mecp_env.slam.rooms.doors import DoorMap, forget_jambs
from tests.slam import make
from tests.slam.drives import scripted_drive
from tests.slam.scans import PAPER, front_end, ring, take_scan

CONFIG = DynamicObjectsConfig()
LIMITS = PruneLimits.of(SlamConfig())
STAGE = make_dynamic_objects(CONFIG, PAPER)
ROOM = ring((-3.0, -2.0), (4.0, -2.0), (4.0, 3.0), (-3.0, 3.0))
ORIGIN = np.array([-4.0, -3.0])


def disc(x, y, radius=0.25):
    angles = -np.arange(16) * (2.0 * math.pi / 16)
    return ring(*np.column_stack([x + radius * np.cos(angles), y + radius * np.sin(angles)]))


def box(x, y, half):
    return ring((x - half, y - half), (x - half, y + half), (x + half, y + half), (x + half, y - half))


def empty_room():
    """The grid of ROOM after it was seen empty: floor up to the walls, walls, unknown beyond."""
    x, y = (ORIGIN[a] + (np.arange(n) + 0.5) * 0.1 for a, n in ((0, 90), (1, 70)))
    x, y = np.meshgrid(x, y)
    label = np.where((x > -3.0) & (x < 4.0) & (y > -2.0) & (y < 3.0), 1, 0).astype(np.uint8)
    wall = (np.abs(x + 3.05) < 0.06) | (np.abs(x - 4.05) < 0.06) | (np.abs(y + 2.05) < 0.06) | (np.abs(y - 3.05) < 0.06)
    label[wall] = 2
    return make.grid(label, origin=ORIGIN)


def belief(*p_map, sigma=0.01):
    return make.belief(p_map=p_map, covs=1e-6, pose_cov=np.diag([sigma**2 / 2, sigma**2 / 2, 1e-8]))


def judged(faces, landmark, normals, scans=6, seen_in=()):
    """The step in which the landmark is pruned, or None."""
    table, where = make.features(1, normals=normals), belief(landmark)
    for step in range(1, scans + 1):
        beams, _, segments, _ = front_end(take_scan(faces, seed=step))
        if step in seen_in:
            table.rows["last_step"][0] = step
        if len(find_pruned(beams, segments, where, table, step, LIMITS)):
            return step
    return None


def test_a_body_on_floor_seen_free_is_dynamic_with_its_whole_rim():
    beams, _, _, _ = front_end(take_scan(np.concatenate([ROOM, disc(1.5, 0.5)])))
    dynamic = STAGE.find(beams, belief(), empty_room())
    points = np.column_stack([beams.ranges * np.cos(beams.bearings), beams.ranges * np.sin(beams.bearings)])
    on_body = np.hypot(*(points - (1.5, 0.5)).T) < 0.4
    assert dynamic[on_body].mean() > 0.95
    assert not dynamic[~on_body].any()


@pytest.mark.parametrize("seed", range(5))
def test_nothing_is_dynamic_in_an_empty_room(seed):
    beams, _, _, _ = front_end(take_scan(ROOM, seed=seed))
    assert STAGE.find(beams, belief(), empty_room()) is None


def test_nothing_is_dynamic_where_it_may_be_a_wall_or_in_the_static_world_of_the_paper():
    beams, _, _, _ = front_end(take_scan(np.concatenate([ROOM, disc(1.5, 0.5)])))
    assert STAGE.find(beams, belief(sigma=1.5), empty_room()) is None
    paper = make_dynamic_objects(SlamConfig.paper().dynamic_objects, PAPER)
    assert type(paper) is StaticWorld
    assert paper.find(beams, belief(), empty_room()) is None


def test_no_wall_is_painted_where_a_dynamic_object_is():
    faces = np.concatenate([ROOM, box(1.5, 0.5, 0.25)])
    beams, _, segments, _ = front_end(take_scan(faces))
    dynamic = STAGE.find(beams, belief(), empty_room())
    painted, left = STAGE.without(beams, segments, dynamic)
    assert len(left.first) < len(segments.first)
    assert all(np.hypot(*(ends.mean(axis=0) - (1.5, 0.5))) > 0.5 for ends in left.points)
    assert not (painted.hit & dynamic).any()
    assert STAGE.without(beams, segments, None) == (beams, segments)


def test_corners_of_a_dynamic_object_are_ignored_and_those_of_the_room_are_not():
    beams, _, _, corners = front_end(take_scan(np.concatenate([ROOM, box(1.5, 0.5, 0.25)])))
    dynamic = STAGE.find(beams, belief(), empty_room())
    new = make.match([-1] * len(corners))
    match = STAGE.reject(new, corners, beams, dynamic)
    points = np.column_stack([corners.z[:, 0] * np.cos(corners.z[:, 1]), corners.z[:, 0] * np.sin(corners.z[:, 1])])
    near = np.hypot(*(points - (1.5, 0.5)).T) < 0.5
    assert near.any()
    assert (match.decision[near] == Decision.IGNORED).all()
    assert (match.reason[near] == Reason.DYNAMIC).all()
    assert (match.decision[~near] == Decision.NEW).all()
    assert (new.decision == Decision.NEW).all()  # messages are immutable


def test_a_landmark_is_forgotten_when_beams_pass_well_beyond_it():
    assert judged(ROOM, (1.5, 0.5), (math.pi, np.nan)) == LIMITS.scans


def test_one_that_is_seen_again_is_not():
    assert judged(ROOM, (1.5, 0.5), (math.pi, np.nan), seen_in=(3, 6)) is None


def test_one_that_is_hidden_is_not():
    assert judged(np.concatenate([ROOM, disc(1.0, 0.33)]), (1.5, 0.5), (math.pi, np.nan)) is None


@pytest.mark.parametrize("corner", [(-3.0, -2.0), (4.0, -2.0), (4.0, 3.0), (-3.0, 3.0)])
def test_corners_of_a_room_stay(corner):
    towards = (0.0 if corner[0] < 0.0 else math.pi, math.pi / 2.0 if corner[1] < 0.0 else -math.pi / 2.0)
    assert judged(ROOM, corner, towards, scans=30) is None


@pytest.mark.parametrize("x", [1.0, 2.0, 3.0])
@pytest.mark.parametrize("y", [-0.9, 0.1, 1.1])
@pytest.mark.parametrize("turn", [0.0, 0.4, 0.785])
def test_corners_of_things_that_stand_in_the_room_stay(x, y, turn):
    c, s = math.cos(turn), math.sin(turn)
    standing = box(0.0, 0.0, 0.15) @ np.array([[c, s], [-s, c]]) + (x, y)
    normals = np.arctan2(*(standing.mean(axis=1) - (x, y)).T[::-1])
    for k in range(4):
        faces = np.concatenate([ROOM, standing])
        assert judged(faces, standing[k, 0], (normals[k - 1], normals[k]), scans=8) is None


def test_a_corner_against_a_wall_is_forgotten_when_the_wall_is_seen_whole():
    assert judged(ROOM, (4.0, 0.5), (math.pi, -math.pi / 2.0)) == LIMITS.scans


def test_a_corner_on_the_other_side_of_the_wall_stays():
    assert judged(ROOM, (4.04, 0.5), (0.0, -math.pi / 2.0), scans=30) is None


def test_doors_forget_the_faces_that_hung_on_a_lost_landmark():
    book = DoorMap(sightings={(0, 1): 4, (4, 5): 3}, candidates=[make.candidate(ids=(4, 9))])
    faces = ((0, 1), (2, 3)), ((4, 5), None), ((6, 7), (8, 9))
    book.set_doors([make.door(id, *both) for id, both in enumerate(faces)])
    forget_jambs(book, np.array([0, 4]))
    assert [(door.id, door.jambs, door.other_face) for door in book.doors] == [(0, (2, 3), None), (2, (6, 7), (8, 9))]
    assert (0, 1) not in book.sightings
    assert not book.candidates


def test_nothing_is_dynamic_and_nothing_pruned_in_a_static_world():
    still = SlamConfig(dynamic_objects=DynamicObjectsConfig(margin_m=0.0))
    drive = scripted_drive(seed=3)
    for (_, watched, _, _), (_, plain, _, _) in zip(drive.run(SlamConfig()), drive.run(still), strict=True):
        assert watched.belief.p_map.tobytes() == plain.belief.p_map.tobytes()
        assert not (watched.match.reason == Reason.DYNAMIC).any()


def test_a_segment_goes_when_more_than_half_of_its_beams_end_on_something_that_moves():
    rng = np.random.default_rng(0)
    for _ in range(200):
        size, roll = 30, int(rng.integers(30))
        cuts = np.sort(rng.choice(size, 6, replace=False))
        first, last, dynamic = cuts[0::2], cuts[1::2], rng.random(size) < 0.5
        of_run = np.roll(dynamic, -roll)  # by position
        plain = [of_run[a : b + 1].mean() <= 0.5 for a, b in zip(first, last, strict=True)]
        segments = make.segments(first=first, last=last, roll=roll)
        assert without_dynamic(segments, dynamic).first.tolist() == first[plain].tolist()


def test_the_rim_of_a_body_is_dynamic_with_its_middle():
    bearings = np.linspace(-1.0, 1.0, 201)
    ranges = np.where(np.abs(bearings) < 0.1, 2.0, 4.0)
    middle, hit = np.abs(bearings) < 0.05, np.ones(201, dtype=bool)
    assert (whole_bodies(ranges, bearings, hit, middle, CONFIG.record) == (ranges == 2.0)).all()


def test_no_landmark_is_forgotten_where_the_pose_is_too_uncertain():
    table, where = make.features(1, normals=(math.pi, np.nan)), belief((1.5, 0.5), sigma=1.0)
    for step in range(1, LIMITS.scans + 3):
        beams, _, segments, _ = front_end(take_scan(ROOM, seed=step))
        assert not len(find_pruned(beams, segments, where, table, step, LIMITS))
