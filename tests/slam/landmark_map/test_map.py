"""The persistent map: tracks, polygons, duplicates."""

from dataclasses import replace

import numpy as np
import pytest

from mecp_env.slam.config import SlamConfig, TrackConfig
from mecp_env.slam.landmark_map.map_polygons import MapPolygonStore
from mecp_env.slam.landmark_map.tracks import drop_tracks, find_duplicate, find_unconfirmed, track_corners
from mecp_env.slam.messages import (
    UNKNOWN_ROOM,
    CornerKind,
    Decision,
    FeatureState,
    FeatureTable,
)
from tests.slam import make

SQUARE = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
ORIGIN = make.belief()


def match_of(decisions, ids=None):
    return make.match([-1] * len(decisions) if ids is None else ids, decisions)


def graph_of(current=0, **fields):
    return make.graph(current, (0, 1), **fields)


def see(table, points, step, kind=0, config=None, graph=None):
    config = SlamConfig(tracks=config or TrackConfig(few_matches=0))
    drop_tracks(table, step, config.tracks)
    seen = make.sighting(make.corners(points=points, kind=kind), make.match([-1] * len(points)), ORIGIN, step)
    return track_corners(table, seen, graph or graph_of(), config)


def test_a_corner_becomes_a_landmark_in_its_third_scan():
    table = FeatureTable()
    for step, (decision, confirmed) in enumerate(
        [(Decision.NEW, 0), (Decision.PROVISIONAL, 0), (Decision.PROVISIONAL, 1)]
    ):
        match, found = see(table, [[2.0, 1.0]], step)
        assert match.decision.tolist() == [int(decision)]
        assert match.ids.tolist() == [0]
        assert len(found) == confirmed


def test_a_jamb_needs_two():
    table = FeatureTable()
    assert [len(see(table, [[2.0, 1.0]], step, kind=2)[1]) for step in range(2)] == [0, 1]


def test_a_track_not_seen_again_dies_and_its_id_never_returns():
    table = FeatureTable()
    see(table, [[2.0, 1.0]], 0)
    assert see(table, [[-2.0, 1.0]], 30)[0].ids.tolist() == [1]
    assert table.rows["state"].tolist() == [FeatureState.DEAD, FeatureState.TRACK]
    assert see(table, [[2.0, 1.0]], 31)[0].ids.tolist() == [2]


def test_a_track_is_not_followed_across_the_room():
    table = FeatureTable()
    see(table, [[2.0, 1.0]], 0)
    assert see(table, [[2.0, 1.5]], 1)[0].ids.tolist() == [1]


def test_two_corners_never_follow_one_track():
    table = FeatureTable()
    see(table, [[2.0, 1.0]], 0)
    ids = see(table, [[2.0, 1.02], [2.0, 0.98]], 1)[0].ids.tolist()
    assert sorted(ids) == [0, 1]


def test_a_track_that_the_associator_chose_is_no_other_corners_track():
    table = FeatureTable()
    first = see(table, [[2.0, 1.0]], 0)[0].ids[0]
    match = make.match([-1, first], [Decision.NEW, Decision.PROVISIONAL])
    seen = make.sighting(make.corners(points=[[2.0, 1.0], [2.0, 1.1]]), match, ORIGIN, 1)
    found, confirmed = track_corners(table, seen, graph_of(), SlamConfig())
    assert found.ids[1] == first != found.ids[0]
    assert len(set(found.ids[confirmed].tolist())) == len(confirmed)


def landmarks(rooms):
    table = FeatureTable()
    see(table, np.concatenate((SQUARE, SQUARE * 2.0))[: len(rooms)], 0)
    table.rows["state"][:] = FeatureState.LANDMARK
    table.rows["room"][:] = rooms
    return table


def ring(*vertices):
    return make.polygon(vertices, make.edges(*(edge % 3 for edge in range(len(vertices)))))


def remember(store, table, polygon, graph):
    store.remember((polygon,), make.match(range(8)), table, graph, 1)


def prune(store, table, graph):
    store.outdated = True
    store.prune(table, graph.resolve)


def test_a_polygon_is_kept_once_whatever_vertex_it_starts_from():
    store, table = MapPolygonStore(32), landmarks([0] * 8)
    remember(store, table, ring(2, 3, 0, 1), graph_of())
    remember(store, table, ring(0, 1, 2, 3), graph_of())
    assert len(store.polygons) == 1
    assert store.polygons[0].ids.tolist() == [0, 1, 2, 3]
    assert store.polygons[0].seen == 2
    assert store.groups[4].ids.tolist() == [[0, 1, 2, 3]]


def test_edge_intervals_stay_with_their_edge():
    store, table = MapPolygonStore(32), landmarks([0] * 8)
    polygon = ring(2, 3, 0, 1)  # its edge 2 is the one from vertex 0 to vertex 1
    remember(store, table, polygon, graph_of())
    labels = {int(edge): label for edge, _, _, label in polygon.intervals}
    assert [label for *_, label in store.polygons[0].intervals] == [labels[2], labels[3], labels[0], labels[1]]
    assert store.polygons[0].intervals[:, 0].tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("graph", [graph_of(current=1), graph_of(in_doorway=True)])
def test_no_polygon_of_another_room_or_from_a_doorway(graph):
    store = MapPolygonStore(32)
    remember(store, landmarks([0] * 8), ring(0, 1, 2, 3), graph)
    assert not store.polygons


def test_no_polygon_over_two_rooms_even_after_a_merge():
    """Fig. 6: polygons of different rooms share no vertex; landmarks that moved, or rooms merged, keep it so."""
    store, table = MapPolygonStore(32), landmarks([0] * 4 + [1] * 4)
    remember(store, table, ring(0, 1, 2, 7), graph_of())
    assert not store.polygons
    remember(store, table, ring(0, 1, 2, 3), graph_of())
    remember(store, table, ring(4, 5, 6, 7), graph_of(current=1))
    table.rows["room"][3] = 1  # it was seen through a door
    prune(store, table, graph_of())
    assert [p.ids.tolist() for p in store.polygons] == [[4, 5, 6, 7]]
    table.rows["room"][table.rows["room"] == 1] = 0
    prune(store, table, graph_of(merged={1: 0}))
    assert [p.room for p in store.polygons] == [0]


def test_polygons_of_dead_tracks_go():
    store, table = MapPolygonStore(32), landmarks([0] * 8)
    remember(store, table, ring(0, 1, 2, 3), graph_of())
    table.rows["state"][2] = FeatureState.DEAD
    prune(store, table, graph_of())
    assert not store.polygons
    assert not store.groups


def test_the_cap_keeps_those_seen_most():
    store, table = MapPolygonStore(1), landmarks([0] * 8)
    remember(store, table, ring(0, 1, 2, 3), graph_of())
    remember(store, table, ring(0, 1, 2, 3), graph_of())
    assert not store.outdated
    remember(store, table, ring(4, 5, 6, 7), graph_of())
    assert store.outdated
    prune(store, table, graph_of())
    assert [p.ids.tolist() for p in store.polygons] == [[0, 1, 2, 3]]


def test_fused_landmarks_leave_no_polygon_with_a_vertex_twice():
    store, table = MapPolygonStore(32), landmarks([0] * 8)
    remember(store, table, ring(0, 1, 2, 3), graph_of())
    remember(store, table, ring(1, 2, 3, 4), graph_of())
    store.rename(keep=0, drop=4)
    prune(store, table, graph_of())
    assert [p.ids.tolist() for p in store.polygons] == [[0, 1, 2, 3]]
    store.rename(keep=0, drop=1)
    prune(store, table, graph_of())
    assert not store.polygons


def believed(offset):
    table = landmarks([0, 0])
    return table, make.belief(p_map=[[2.0, 1.0], [2.0 + offset, 1.0]], pose_cov=1.0, covs=1e-3)


def test_two_landmarks_on_one_corner_are_found():
    table, belief = believed(0.03)
    assert find_duplicate(table, belief, make.match([1]), SlamConfig()) == (0, 1)


def test_two_faces_of_a_wall_are_no_duplicates():
    table, belief = believed(0.03)
    table.rows["normals"][1] += np.pi
    assert find_duplicate(table, belief, make.match([1]), SlamConfig()) is None


@pytest.mark.parametrize(("offset", "ids"), [(0.2, [1]), (0.03, [0, 1])])
def test_landmarks_apart_or_seen_side_by_side_are_two(offset, ids):
    table, belief = believed(offset)
    assert find_duplicate(table, belief, make.match(ids), SlamConfig()) is None


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
