"""The persistent map: tracks, polygons, duplicates, and dynamic objects, which are not landmarks."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mecp_env.core.se2 import polar_to_points
from mecp_env.slam.config import DynamicObjectsConfig, SlamConfig, TrackConfig
from mecp_env.slam.landmark_map import MapPolygonStore, link
from mecp_env.slam.landmark_map.dynamic_objects import StaticWorld, make_dynamic_objects, without_dynamic
from mecp_env.slam.landmark_map.tracks import (
    PruneLimits,
    drop_tracks,
    find_duplicate,
    find_pruned,
    find_unconfirmed,
    track_corners,
)
from mecp_env.slam.messages import UNKNOWN_ROOM, CornerKind, Decision, FeatureState, FeatureTable, Reason
from mecp_env.slam.rooms.doors import DoorMap, forget_jambs
from tests.slam import make
from tests.slam.scans import PAPER, front_end, ring, take_scan

SQUARE = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
ORIGIN = make.belief()
CONFIG = DynamicObjectsConfig()
LIMITS = PruneLimits.of(SlamConfig())
STAGE = make_dynamic_objects(CONFIG, PAPER)
ROOM = ring((-3.0, -2.0), (4.0, -2.0), (4.0, 3.0), (-3.0, 3.0))
CORNER = np.array([-4.0, -3.0])
WEST, IN_THE_ROOM = (math.pi, np.nan), (1.5, 0.5)


def graph_of(current=0, **fields):
    return make.graph(current, (0, 1), **fields)


def see(table, points, step, kind=0, config=None, graph=None):
    config = SlamConfig(tracks=config or TrackConfig(few_matches=0))
    drop_tracks(table, step, config.tracks)
    seen = make.sighting(make.corners(points=points, kind=kind), make.match([-1] * len(points)), ORIGIN, step)
    return track_corners(table, seen, graph or graph_of(), config)


@pytest.mark.parametrize(("kind", "needed"), [(CornerKind.CROSSING, 3), (CornerKind.JAMB, 2)])
def test_a_corner_becomes_a_landmark_in_its_third_scan_and_a_jamb_in_its_second(kind, needed):
    table = FeatureTable()
    for step in range(needed):
        match, found = see(table, [[2.0, 1.0]], step, int(kind))
        assert match.decision.tolist() == [int(Decision.PROVISIONAL if step else Decision.NEW)]
        assert match.ids.tolist() == [0]
        assert len(found) == (step == needed - 1)


def test_a_track_not_seen_again_dies_and_its_id_never_returns():
    table = FeatureTable()
    see(table, [[2.0, 1.0]], 0)
    assert see(table, [[-2.0, 1.0]], 30)[0].ids.tolist() == [1]
    assert table.rows["state"].tolist() == [FeatureState.DEAD, FeatureState.TRACK]
    assert see(table, [[2.0, 1.0]], 31)[0].ids.tolist() == [2]


def test_two_corners_never_follow_one_track_nor_one_across_the_room():
    table = FeatureTable()
    see(table, [[2.0, 1.0]], 0)
    ids = see(table, [[2.0, 1.02], [2.0, 0.98], [2.0, 1.5]], 1)[0].ids.tolist()
    assert sorted(ids) == [0, 1, 2]


def landmarks(rooms):
    table = FeatureTable()
    see(table, np.concatenate((SQUARE, SQUARE * 2.0))[: len(rooms)], 0)
    table.rows["state"][:] = FeatureState.LANDMARK
    table.rows["room"][:] = rooms
    return table


def polygon(*vertices):
    return make.polygon(vertices, make.edges(*(edge % 3 for edge in range(len(vertices)))))


def remember(store, table, polygon, graph):
    store.remember((polygon,), make.match(range(8)), table, graph, 1)


def prune(store, table, graph):
    store.outdated = True
    store.prune(table, graph.resolve)


def test_no_polygon_over_two_rooms_even_after_a_merge():
    """Fig. 6: polygons of different rooms share no vertex; landmarks that moved, or rooms merged, keep it so."""
    store, table = MapPolygonStore(32), landmarks([0] * 4 + [1] * 4)
    remember(store, table, polygon(0, 1, 2, 7), graph_of())
    assert not store.polygons
    remember(store, table, polygon(0, 1, 2, 3), graph_of())
    remember(store, table, polygon(4, 5, 6, 7), graph_of(current=1))
    table.rows["room"][3] = 1  # it was seen through a door
    prune(store, table, graph_of())
    assert [p.ids.tolist() for p in store.polygons] == [[4, 5, 6, 7]]
    table.rows["room"][table.rows["room"] == 1] = 0
    prune(store, table, graph_of(merged={1: 0}))
    assert [p.room for p in store.polygons] == [0]


def test_the_cap_keeps_those_seen_most():
    store, table = MapPolygonStore(1), landmarks([0] * 8)
    remember(store, table, polygon(0, 1, 2, 3), graph_of())
    remember(store, table, polygon(2, 3, 0, 1), graph_of())  # the same, whatever vertex it starts from
    assert not store.outdated
    assert store.polygons[0].seen == 2
    assert store.groups[4].ids.tolist() == [[0, 1, 2, 3]]
    remember(store, table, polygon(4, 5, 6, 7), graph_of())
    assert store.outdated
    prune(store, table, graph_of())
    assert [p.ids.tolist() for p in store.polygons] == [[0, 1, 2, 3]]


def test_fused_landmarks_leave_no_polygon_with_a_vertex_twice():
    store, table = MapPolygonStore(32), landmarks([0] * 8)
    remember(store, table, polygon(0, 1, 2, 3), graph_of())
    remember(store, table, polygon(1, 2, 3, 4), graph_of())
    store.rename(keep=0, drop=4)
    prune(store, table, graph_of())
    assert [p.ids.tolist() for p in store.polygons] == [[0, 1, 2, 3]]
    store.rename(keep=0, drop=1)
    prune(store, table, graph_of())
    assert not store.polygons


@pytest.mark.parametrize(
    ("offset", "turned", "seen", "found"),
    [
        (0.03, 0.0, [1], (0, 1)),
        (0.03, np.pi, [1], None),  # two faces of a wall
        (0.2, 0.0, [1], None),
        (0.03, 0.0, [0, 1], None),  # seen side by side
    ],
)
def test_two_landmarks_on_one_corner_are_found(offset, turned, seen, found):
    table = landmarks([0, 0])
    table.rows["normals"][1] += turned
    belief = make.belief(p_map=[[2.0, 1.0], [2.0 + offset, 1.0]], pose_cov=1.0, covs=1e-3)
    assert find_duplicate(table, belief, make.match(seen), SlamConfig()) == found


def test_while_few_landmarks_are_in_view_one_sighting_is_enough_and_what_is_not_seen_again_is_removed():
    table, config = FeatureTable(), TrackConfig()
    match, confirmed = see(table, [[2.0, 1.0], [2.0, -1.0]], 0, config=config)
    assert confirmed.tolist() == [0, 1]
    table.rows["state"][match.ids] = int(FeatureState.LANDMARK)
    table.rows["seen"][0] = config.sightings
    late = config.window_steps + 1
    assert find_unconfirmed(table.rows, match.ids, config.record, config.window_steps).tolist() == []
    assert find_unconfirmed(table.rows, match.ids, config.record, late).tolist() == [1]


def test_jambs_in_view_do_not_count_where_predictions_are_wide():
    """At odometry x4 the pose was lost beyond a door: all in view before it were two jambs and two corners."""
    points, config = np.array([[0.4, 0.5], [0.4, -0.5], [-1.0, 1.0], [-1.0, -1.0], [3.0, 1.0]]), SlamConfig()
    for kind, wide, confirmed in (
        (CornerKind.CROSSING, True, []),
        (CornerKind.JAMB, False, []),
        (CornerKind.JAMB, True, [4]),
    ):
        table = make.features(4, state=FeatureState.LANDMARK, kind=[kind, kind, 0, 0], seen=9)
        seen = make.sighting(make.corners(points=points), make.match([0, 1, 2, 3, -1]), ORIGIN, 1)
        assert track_corners(table, seen, graph_of(), config, wide)[1].tolist() == confirmed


def test_a_line_end_belongs_to_the_room_that_it_is_seen_from_inside():
    config = TrackConfig(few_matches=0)
    table, end = FeatureTable(), int(CornerKind.FREE_END)
    from_doorway = [see(table, [[2.0, 1.0]], step, end, config, graph_of(in_doorway=True)) for step in range(3)]
    assert [len(confirmed) for _, confirmed in from_doorway] == [0, 0, 1]
    assert table.rows["room"].tolist() == [UNKNOWN_ROOM]
    see(table, [[2.0, 1.0]], 3, end, config, graph_of(current=1))
    see(table, [[2.0, 1.0]], 4, end, config, graph_of(current=0))
    assert table.rows["room"].tolist() == [1]


def test_the_room_of_a_corner_is_that_behind_its_door_and_open_beyond_a_gap():
    graph = make.graph(rooms=(0, 3), doors=(make.door(7, rooms=(0, 3)), make.door(8, (2, 3))))
    beyond, through = np.array([-1, 0, -1, -1]), np.array([-1, -1, 7, 8])
    assert graph.rooms_of(beyond, through).tolist() == [0, UNKNOWN_ROOM, 3, UNKNOWN_ROOM]
    assert replace(graph, in_doorway=True).rooms_of(beyond, through).tolist() == [UNKNOWN_ROOM] * 4


def disc(x, y, radius=0.25):
    angles = -np.arange(16) * (2.0 * math.pi / 16)
    return ring(*np.column_stack([x + radius * np.cos(angles), y + radius * np.sin(angles)]))


def box(x, y, half):
    return ring((x - half, y - half), (x - half, y + half), (x + half, y + half), (x + half, y - half))


def empty_room():
    """The grid of ROOM after it was seen empty: floor up to the walls, walls, unknown beyond."""
    x, y = (CORNER[a] + (np.arange(n) + 0.5) * 0.1 for a, n in ((0, 90), (1, 70)))
    x, y = np.meshgrid(x, y)
    label = np.where((x > -3.0) & (x < 4.0) & (y > -2.0) & (y < 3.0), 1, 0).astype(np.uint8)
    wall = (np.abs(x + 3.05) < 0.06) | (np.abs(x - 4.05) < 0.06) | (np.abs(y + 2.05) < 0.06) | (np.abs(y - 3.05) < 0.06)
    label[wall] = 2
    return make.grid(label, origin=CORNER)


def belief(*p_map, sigma=0.01):
    return make.belief(p_map=p_map, covs=1e-6, pose_cov=np.diag([sigma**2 / 2, sigma**2 / 2, 1e-8]))


def judged(faces, landmark, normals, scans=6, seen_in=(), sigma=0.01):
    """The step in which the landmark is pruned, or None."""
    table, where = make.features(1, normals=normals), belief(landmark, sigma=sigma)
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
    points = polar_to_points(np.column_stack([beams.ranges, beams.bearings]))
    on_body = np.hypot(*(points - (1.5, 0.5)).T) < 0.4
    assert dynamic[on_body].mean() > 0.95
    assert not dynamic[~on_body].any()


def test_nothing_is_dynamic_in_an_empty_room_where_it_may_be_a_wall_or_in_the_static_world_of_the_paper():
    for seed in range(5):
        assert STAGE.find(front_end(take_scan(ROOM, seed=seed))[0], belief(), empty_room()) is None
    beams, _, _, _ = front_end(take_scan(np.concatenate([ROOM, disc(1.5, 0.5)])))
    assert STAGE.find(beams, belief(sigma=1.5), empty_room()) is None
    paper = make_dynamic_objects(SlamConfig.paper().dynamic_objects, PAPER)
    assert type(paper) is StaticWorld
    assert paper.find(beams, belief(), empty_room()) is None


def test_no_wall_is_painted_and_no_corner_taken_where_a_dynamic_object_is():
    beams, _, segments, corners = front_end(take_scan(np.concatenate([ROOM, box(1.5, 0.5, 0.25)])))
    dynamic = STAGE.find(beams, belief(), empty_room())
    painted, left = STAGE.without(beams, segments, dynamic)
    assert len(left.first) < len(segments.first)
    assert all(np.hypot(*(ends.mean(axis=0) - (1.5, 0.5))) > 0.5 for ends in left.points)
    assert not (painted.hit & dynamic).any()
    assert STAGE.without(beams, segments, None) == (beams, segments)
    new = make.match([-1] * len(corners))
    match = STAGE.reject(new, corners, beams, dynamic)
    near = np.hypot(*(polar_to_points(corners.z) - (1.5, 0.5)).T) < 0.5
    assert near.any()
    assert (match.decision[near] == Decision.IGNORED).all()
    assert (match.reason[near] == Reason.DYNAMIC).all()
    assert (match.decision[~near] == Decision.NEW).all()


@pytest.mark.parametrize(
    ("faces", "landmark", "normals", "options", "forgotten"),
    [
        (ROOM, IN_THE_ROOM, WEST, {}, True),  # beams pass well beyond it
        (ROOM, IN_THE_ROOM, WEST, {"seen_in": (3, 6)}, False),
        (ROOM, IN_THE_ROOM, WEST, {"sigma": 1.0}, False),  # the pose is too uncertain
        (np.concatenate([ROOM, disc(1.0, 0.33)]), IN_THE_ROOM, WEST, {}, False),  # it is hidden
        (ROOM, (4.0, 0.5), (math.pi, -math.pi / 2.0), {}, True),  # at a wall that is seen whole
        (ROOM, (4.04, 0.5), (0.0, -math.pi / 2.0), {"scans": 30}, False),  # on the other side of it
        (ROOM, (-3.0, -2.0), (0.0, math.pi / 2.0), {"scans": 30}, False),  # a corner of the room
        (ROOM, (4.0, 3.0), (math.pi, -math.pi / 2.0), {"scans": 30}, False),
    ],
)
def test_a_landmark_is_forgotten_when_beams_pass_where_it_should_be(faces, landmark, normals, options, forgotten):
    assert judged(faces, landmark, normals, **options) == (LIMITS.scans if forgotten else None)


@pytest.mark.parametrize(("x", "y", "turn"), [(1.0, 0.1, 0.4), (2.0, 1.1, 0.0), (3.0, -0.9, 0.785), (3.0, 0.1, 0.0)])
def test_corners_of_things_that_stand_in_the_room_stay(x, y, turn):
    c, s = math.cos(turn), math.sin(turn)
    standing = box(0.0, 0.0, 0.15) @ np.array([[c, s], [-s, c]]) + (x, y)
    normals = np.arctan2(*(standing.mean(axis=1) - (x, y)).T[::-1])
    for k in range(4):
        faces = np.concatenate([ROOM, standing])
        assert judged(faces, standing[k, 0], (normals[k - 1], normals[k]), scans=8) is None


def test_doors_forget_the_faces_that_hung_on_a_lost_landmark():
    book = DoorMap(sightings={(0, 1): 4, (4, 5): 3}, candidates=[make.candidate(ids=(4, 9))])
    faces = ((0, 1), (2, 3)), ((4, 5), None), ((6, 7), (8, 9))
    book.set_doors([make.door(id, *both, rooms=(0, id)) for id, both in enumerate(faces)])
    forget_jambs(book, np.array([0, 4]), make.belief((0.0, 0.0, 0.0), np.random.default_rng(0).normal(size=(10, 2))))
    assert [(door.id, door.jambs, door.other_face) for door in book.doors] == [(0, (2, 3), None), (2, (6, 7), (8, 9))]
    assert (0, 1) not in book.sightings
    assert not book.candidates
    assert [passage.rooms for passage in book.passages] == [(0, 1)]


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


def test_a_polygon_is_linked_to_features_of_its_room_from_the_least_id():
    ids, rows = np.array([8, 3, 5, -1, 3]), make.features(9, room=[0, 0, 0, 1, 0, 1, 0, 0, 1]).rows
    intervals = np.array([[0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.5, 0.0], [1.0, 0.5, 1.0, 2.0], [2.0, 0.0, 1.0, 1.0]])

    def linked(corners, current):
        ring, rolled = np.empty(len(corners), np.int64), np.empty_like(intervals)
        sound = link(np.array(corners), ids, rows, current, ring, intervals, rolled)
        return (ring.tolist(), rolled[:, 0].tolist()) if sound else None

    assert linked([0, 1, 2], 1) == ([3, 5, 8], [0.0, 0.0, 1.0, 2.0])
    assert linked([0, 1, 2], 0) is None  # another room
    assert linked([0, 1, 3], 1) is None  # a corner without an id
    assert linked([1, 2, 4], 1) is None  # one feature twice
