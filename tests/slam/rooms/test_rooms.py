"""Door and room logic on scripted walks, and the path since a room was entered."""

from dataclasses import replace

import numpy as np
import pytest
from shapely.geometry import LineString

from mecp_env.core.se2 import to_robot
from mecp_env.slam.config import CornerConfig, SlamConfig
from mecp_env.slam.parts import room_limits
from mecp_env.slam.rooms import RoomGraphEstimator, Trail, last_crossing
from mecp_env.slam.rooms.doors import DoorMap, beyond_doors, gap_frame, rename_jambs, rooms_beside
from tests.slam import make

# a wall along y = 0, 0.12 m thick, with a door of 0.9 m around x = 0: jambs of the lower and the upper face
LOWER = {0: (0.45, -0.06), 1: (-0.45, -0.06)}  # seen from below: right is +x, left is -x
UPPER = {2: (-0.45, 0.06), 3: (0.45, 0.06)}  # seen from above: right is -x
OTHERS = {4: (-2.0, -3.0), 5: (2.0, -3.0), 6: (2.0, -0.06), 7: (-2.0, 3.0), 8: (2.0, 3.0), 9: (2.0, 0.06)}

LIMITS = room_limits(SlamConfig())
THIN_WALLS = room_limits(SlamConfig(corners=CornerConfig(wall_thickness_m=0.4)))
MOST = LIMITS.trail_places
GAP = np.array([[0.45, 0.0], [-0.45, 0.0]])


def belief_at(x, y, heading=0.0):
    points = {**LOWER, **UPPER, **OTHERS}
    return make.belief((x, y, heading), [points[i] for i in sorted(points)], covs=1e-6)


def features():
    return make.features(10, state=1, convex=True, seen=1)


def sighting(belief, ids, pairs=(), confirmable=True):
    """Corners and match of a scan that sees the landmarks `ids`, `pairs` of them (positions in ids) as doorways."""
    points = to_robot(belief.T_map_robot, belief.p_map[list(ids)])
    return make.corners(points=points, cov=1e-6, gaps=make.doorways(pairs, confirmable)), make.match(ids, nis=0.0)


def look(keeper, belief, ids, pairs=(), confirmable=True, table=None, polygon_room=None):
    corners, match = sighting(belief, ids, pairs, confirmable)
    corners, through = keeper.mark_beyond(corners, belief)
    known = []
    if polygon_room is not None:
        known = [make.map_polygon(match.ids, polygon_room)]
        match = replace(match, polygon=0, known=0)
    keeper.update(make.sighting(corners, match, belief, through=through), table or features(), known)


def gap(keeper, y, times=3, **more):
    """The jambs of the face on this side are seen so many times, with the gap between them."""
    for _ in range(times):
        look(keeper, belief_at(0.0, y), (0, 1) if y < 0.0 else (2, 3), ((0, 1),), **more)


def keeper_with_door():
    keeper = RoomGraphEstimator(LIMITS)
    gap(keeper, -1.5)
    return keeper


def seen_twice(keeper):
    """Landmarks of the upper room are seen from two places there, as vertices of a polygon of the lower room."""
    for x in (0.0, 0.8):
        look(keeper, belief_at(x, 1.0), (7, 8, 9), polygon_room=0)


def in_upper_room():
    """A keeper that knows the door and has passed it."""
    keeper = keeper_with_door()
    walk(keeper, (-0.5, 0.0, 0.5))
    return keeper


def test_a_robot_that_was_lost_is_in_the_room_of_most_of_the_landmarks_it_is_found_by():
    keeper, table = keeper_with_door(), features()
    keeper.merged, keeper.in_doorway = {3: 1}, True
    table.rows["room"] = [2, 2, 1, 3, 1, -1, -1, -1, -1, 0]
    keeper.arrive_at(np.array([5, 6]), table)
    assert keeper.current == 0  # nobody knows where they are
    keeper.arrive_at(np.arange(9), table)
    assert keeper.current == 1
    assert not keeper.in_doorway


def walk(keeper, ys, x=0.0, table=None):
    rooms = []
    for y in ys:
        look(keeper, belief_at(x, y), (), table=table)
        rooms.append(keeper.current)
    return rooms


def test_a_door_needs_three_sightings_and_is_a_candidate_until_then():
    keeper = RoomGraphEstimator(LIMITS)
    for expected in (0, 0, 1):
        gap(keeper, -1.5, times=1)
        assert len(keeper.door_map.doors) == expected
        assert len(keeper.door_map.candidates) == 1 - expected
    assert keeper.door_map.doors[0].rooms == (0, -1)


def test_sightings_count_for_the_gap_not_for_the_ids_of_its_jambs():
    """Two sightings of one face and one of the other; a jamb that was dropped and found again has new ids."""
    keeper = RoomGraphEstimator(LIMITS)
    gap(keeper, -1.5, times=2)
    gap(keeper, -6.0, times=10, confirmable=False)  # from afar it stays a candidate
    assert [candidate.confirmable for candidate in keeper.door_map.candidates] == [2]
    gap(keeper, 1.5, times=1)
    assert [(door.jambs, door.sightings) for door in keeper.door_map.doors] == [((2, 3), 3)]


def test_oscillation_on_the_threshold_changes_nothing():
    keeper = keeper_with_door()
    assert set(walk(keeper, (-0.2, 0.2) * 10)) == {0}
    assert keeper.in_doorway
    assert set(walk(keeper_with_door(), (-0.5, 0.0, 0.5), x=2.0)) == {0}  # past the wall beside the door


def test_the_same_door_from_both_sides_is_one_door():
    keeper = keeper_with_door()
    walk(keeper, (-0.5, 0.0, 0.5, 1.5))
    gap(keeper, 1.5, times=4)
    assert len(keeper.door_map.doors) == 1
    assert keeper.door_map.doors[0].other_face == (3, 2)
    assert keeper.door_map.doors[0].rooms == (0, 1)
    assert np.allclose(keeper.door_map.frames(belief_at(0, 0))[0], [0, 0, 0, -1, 0.45])


def test_a_known_room_entered_through_a_door_seen_from_its_far_side_is_not_a_new_room():
    keeper = keeper_with_door()
    keeper.current, keeper.rooms = 7, [0, 7]  # the robot came round the ring into the room above
    gap(keeper, 1.5)
    assert walk(keeper, (0.5, 0.0, -0.5)) == [7, 7, 0]
    assert keeper.graph().rooms == (0, 7)


def test_what_is_seen_through_a_door_is_marked_and_no_site():
    keeper = keeper_with_door()
    keeper.config = THIN_WALLS
    belief = belief_at(0.0, -2.0)
    corners, _ = sighting(belief, (0, 2, 7, 8, 4))
    marked, through = keeper.mark_beyond(corners, belief)
    door = keeper.door_map.doors[0].id
    assert through.tolist() == [-1, -1, -1, -1, -1]  # 7 and 8 lie behind the wall, not behind the gap
    far = belief_at(0.0, -0.5)
    marked, through = keeper.mark_beyond(sighting(far, (0, 7, 8, 4))[0], far)
    assert through.tolist() == [-1, door, door, -1]
    assert marked.sites.tolist() == [True, False, False, True]


def test_what_is_seen_beside_the_gap_by_less_than_a_wall_is_seen_through_it():
    """The pose is that uncertain; taken for corners of this room, they made two rooms one (`hard`, with people)."""
    belief, row = belief_at(-0.6, -0.56), np.empty(1, np.int64)  # the line to landmark 7 crosses the wall at x = -0.8
    for half, expected in ((0.85, 0), (0.65, 0), (0.55, -1)):
        door = np.array([[0.0, -0.06, 0.0, -1.0, half]])
        beyond_doors(belief.T_map_robot, belief.p_map[[7]], door, THIN_WALLS.behind_wall_m, row)
        assert row[0] == expected


def test_beyond_doors_against_shapely():
    rng, row = np.random.default_rng(3), np.empty(1, np.int64)
    door, along = np.array([[0.3, -0.2, np.cos(0.4), np.sin(0.4), 0.45]]), np.array([-np.sin(0.4), np.cos(0.4)])
    opening = LineString([door[0, :2] - 0.45 * along, door[0, :2] + 0.45 * along])
    for robot, point in rng.uniform(-3, 3, (500, 2, 2)):
        beyond_doors(robot, point[None], door, 0.0, row)
        assert (row[0] == 0) == LineString([robot, point]).crosses(opening)


def test_a_door_passed_before_it_was_seen_parts_the_rooms_when_it_is():
    keeper, table = RoomGraphEstimator(LIMITS), features()
    walk(keeper, np.arange(-1.5, 1.6, 0.25))
    assert keeper.current == 0  # no door was known
    table.rows["room"][7:] = 0
    keeper.trail.places[:, 3] = np.where(keeper.trail.places[:, 1] > 0.0, 7, 0)  # 7, 8 and 9 were first seen up there
    gap(keeper, 1.5, table=table)
    assert (keeper.current, keeper.graph().rooms) == (1, (0, 1))
    assert keeper.door_map.doors[0].rooms == (1, 0)  # its face is one of the new room
    assert table.rows["room"][7:].tolist() == [1, 1, 1]
    assert table.rows["room"][4:7].tolist() == [0, 0, 0]
    assert keeper.graph().parted[1][0] == 0
    assert walk(keeper, (0.5, 0.0, -0.5)) == [1, 1, 0]


def test_a_polygon_made_while_the_door_was_unknown_does_not_merge_the_rooms_it_parts():
    keeper = RoomGraphEstimator(LIMITS, rooms=[0, 1], current=1, newest=1, next_room=2, parted={1: (0, 5)})
    seen_twice(keeper)
    assert keeper.current == 1


def test_a_door_first_seen_through_another_is_given_to_the_room_that_it_is_seen_from():
    keeper = in_upper_room()
    beyond = make.door(1, (7, 8))  # a door of the upper room, seen through the first one
    keeper.door_map.set_doors([*keeper.door_map.doors, beyond])
    look(keeper, belief_at(0.0, 1.0), (7, 8), ((0, 1),), confirmable=False)
    assert keeper.door_map.doors[1].rooms == (0, -1)
    look(keeper, belief_at(0.0, 1.0), (7, 8), ((0, 1),))
    assert keeper.door_map.doors[1].rooms == (1, -1)


def test_a_gap_inside_one_room_is_no_door_once_a_polygon_around_the_robot_is_recognised():
    keeper = in_upper_room()
    seen_twice(keeper)
    assert keeper.current == 0
    gap(keeper, 1.5, times=5)  # nor is it taken for one again
    gap(keeper, -1.5, times=5)
    assert keeper.graph().doors == ()
    assert keeper.graph().candidates == ()


@pytest.mark.parametrize(("rooms", "then"), [([1, 1, 1, 5], [1, 1, 1, 1]), ([1, 1, 5, 5], [1, 1, 5, 5])])
def test_landmarks_first_seen_through_two_doors_do_not_keep_the_room_behind_the_first(rooms, then):
    """Bug: such a corner kept the polygons of its room out of the map, and with them 3 % of the floor of `paper`."""
    keeper, table, ids = in_upper_room(), features(), (2, 7, 8, 9)
    table.rows["room"][list(ids)] = rooms
    look(keeper, belief_at(0.0, 1.0), ids, table=table)
    assert table.rows["room"][list(ids)].tolist() == then
    assert keeper.current == 1
    assert len(keeper.graph().rooms) == 2


def to_and_fro(keeper, table, rounds):
    """Landmarks 7, 8 and 9 are seen from above the gap and, past it, from below; they are moved each time."""
    for _ in range(rounds):
        look(keeper, belief_at(0.0, 1.0), (7, 8, 9), table=table)
        walk(keeper, (0.5, 0.0, -0.5), table=table)
        look(keeper, belief_at(-3.0, -1.0), (7, 8, 9), table=table)  # not through the gap
        walk(keeper, (-0.5, 0.0, 0.5), table=table)


@pytest.mark.parametrize("two_faces", [False, True])
def test_rooms_are_one_when_landmarks_are_seen_from_both_sides_of_a_gap_that_is_no_door_with_two_faces(two_faces):
    keeper, table = in_upper_room(), features()
    gap(keeper, 1.5, times=3 * two_faces, table=table)
    to_and_fro(keeper, table, 3 if two_faces else 1)
    assert keeper.graph().rooms == ((0, 1) if two_faces else (0,))
    assert len(keeper.graph().doors) == two_faces
    assert two_faces or table.rows["room"][7:].tolist() == [0, 0, 0]


def test_an_old_room_recognised_is_entered_and_merged_only_where_the_room_left_has_no_corners_of_its_own():
    """A corridor entered twice through an unknown door, and left soon both times, stayed two rooms (`hard`)."""
    table = features()
    for own, rooms in ((3, (0, 1)), (2, (0,))):
        keeper = RoomGraphEstimator(LIMITS, rooms=[0, 1], current=1, newest=-1, next_room=2)
        table.rows["room"] = [0] * (10 - own) + [1] * own
        for x, current in ((0.0, 1), (0.1, 1), (1.6, 0)):  # the second place is too near to the first
            look(keeper, belief_at(x, -2.0), (4, 5, 6), table=table)
            assert keeper.current == current
        assert keeper.graph().rooms == rooms


def test_a_room_left_soon_after_another_was_recognised_there_is_that_one():
    """The robot came round a ring, saw landmarks of room 7 from one place only, and turned back."""
    keeper, table = keeper_with_door(), features()
    keeper.rooms, keeper.next_room = [0, 7], 8
    walk(keeper, (-0.5, 0.2, 0.5), table=table)
    assert keeper.current == 8
    table.rows["room"][7:] = 7
    look(keeper, belief_at(0.0, 0.5), (7, 8, 9), table=table)
    assert walk(keeper, (0.2, -0.2, -0.5), table=table) == [8, 8, 0]
    assert keeper.graph().rooms == (0, 7)
    assert keeper.door_map.doors[0].rooms == (0, 7)


def test_a_door_of_other_rooms_is_followed_when_the_path_leads_through_it():
    """Behind a door that was seen from one side only is the room that the robot comes from."""
    keeper = keeper_with_door()
    keeper.rooms, keeper.current, keeper.newest = [0, 7], 7, 7  # the robot came round the ring into the room above
    keeper.trail = Trail()
    assert walk(keeper, (1.5, 0.5, 0.0, -0.2, -0.5)) == [7, 7, 7, 7, 0]
    assert keeper.graph().rooms == (0, 7)
    assert keeper.door_map.doors[0].rooms == (0, 7)
    keeper.rooms, keeper.current, keeper.trail = [0, 7, 9], 9, Trail()
    assert walk(keeper, (-0.5, 0.2, 0.5)) == [9, 9, 7]
    keeper = keeper_with_door()
    keeper.rooms, keeper.current, keeper.trail = [0, 7], 7, Trail()
    assert set(walk(keeper, (-0.5, -0.4, -0.5))) == {7}  # to be behind it is no crossing


def test_fused_jambs_keep_the_door():
    book = DoorMap([], [], {(0, 1): 3, (9, 1): 1}, 1)
    book.set_doors([make.door()])
    rename_jambs(book, 9, 0)
    assert book.doors[0].jambs == (9, 1)
    assert book.sightings == {(9, 1): 4}


def without_door():
    """A keeper that has passed the door into room 1, and then lost its jambs."""
    keeper = in_upper_room()
    keeper.forget(np.array([0, 1]), belief_at(0.0, 0.5))
    assert not keeper.door_map.doors
    return keeper


@pytest.mark.parametrize("seen", [{}, {"times": 1, "confirmable": False}], ids=["door", "candidate"])
def test_a_gap_where_a_door_was_joins_the_same_rooms(seen):
    """A jamb that came and went made one KTH room ten: each was explored again."""
    keeper = without_door()
    gap(keeper, 1.5, **seen)
    assert walk(keeper, (0.5, 0.0, -0.5)) == [1, 1, 0]
    assert [door.rooms for door in keeper.door_map.doors] == [(1, 0)]
    assert keeper.graph().rooms == (0, 1)


def test_a_door_passed_before_it_was_seen_again_leads_into_the_known_room():
    keeper = without_door()
    assert walk(keeper, (0.5, 0.0, -0.5)) == [1, 1, 1]
    gap(keeper, -1.5)
    assert keeper.current == 0
    assert [door.rooms for door in keeper.door_map.doors] == [(0, 1)]


def test_a_gap_elsewhere_or_across_leads_into_a_new_room():
    keeper = without_door()
    for x, y, normal in ((1.0, 0.0, (0.0, -1.0)), (0.0, 0.0, (-1.0, 0.0))):
        assert rooms_beside(keeper.door_map, np.array([x, y, *normal, 0.45]), LIMITS) == (-1, -1)
    assert rooms_beside(keeper.door_map, np.array([0.1, 0.1, 0.0, -1.0, 0.45]), LIMITS) == (0, 1)
    assert rooms_beside(keeper.door_map, gap_frame(GAP[::-1]), LIMITS) == (1, 0)


def test_rooms_that_merge_are_joined_by_no_passage():
    keeper = without_door()
    seen_twice(keeper)
    assert keeper.graph().rooms == (0,)
    assert not keeper.door_map.passages


def test_driving_through_a_candidate_opens_a_room_and_makes_it_a_door():
    keeper = RoomGraphEstimator(LIMITS)
    gap(keeper, -1.5, times=1, confirmable=False)
    assert len(keeper.door_map.candidates) == 1
    assert walk(keeper, (-0.5, -0.1, 0.1, 0.3, 0.5)) == [0, 0, 0, 1, 1]
    assert [door.rooms for door in keeper.door_map.doors] == [(0, 1)]
    assert not keeper.door_map.candidates
    assert walk(keeper, (0.1, -0.5)) == [1, 0]


def test_a_candidate_of_a_room_that_was_merged_since_leads_from_the_room_of_now():
    """Its door named the old room, in which the robot was on its way back; the next merge ended the exploration."""
    keeper = RoomGraphEstimator(LIMITS)
    keeper.current, keeper.rooms, keeper.next_room = 1, [0, 1], 2
    gap(keeper, -1.5, times=1, confirmable=False)
    keeper.rooms, keeper.merged = [0], {1: 0}
    keeper.place(0)
    walk(keeper, (-0.5, -0.1, 0.1, 0.3, 0.5))
    assert [door.rooms for door in keeper.door_map.doors] == [(0, 2)]
    assert walk(keeper, (0.1, -0.5)) == [2, 0]


def test_a_room_behind_a_gap_that_was_driven_through_is_not_the_one_its_corners_were_assigned_to():
    """They were seen before, through a gap that was no door yet; a home and KTH floors lost rooms by that."""
    keeper, table = RoomGraphEstimator(LIMITS), features()
    gap(keeper, -1.5, times=1, confirmable=False, table=table)
    assert walk(keeper, (-0.5, -0.1, 0.1, 0.3, 0.5), table=table)[-1] == 1
    for y in (0.8, 1.6, 2.8):
        look(keeper, belief_at(0.0, y), (7, 8, 9), table=table)
    assert keeper.current == 1
    assert keeper.graph().rooms == (0, 1)
    assert table.rows["room"][[7, 8, 9]].tolist() == [1, 1, 1]


def test_the_last_crossing_of_a_gap_also_against_shapely():
    there, and_back, again = (-1.0, -0.5, 0.5, 1.0), (-1.0, 1.0, -1.0), (-1.0, 1.0, -1.0, 1.0)
    for ys, crossing in ((there, 2), (and_back, -1), (again, 3), ((), -1)):
        assert last_crossing(np.array([(0.0, y) for y in ys]).reshape(-1, 2), GAP) == crossing
    rng = np.random.default_rng(4)
    for _ in range(500):
        step, gap = rng.uniform(-2, 2, (2, 2)), rng.uniform(-2, 2, (2, 2))
        assert (last_crossing(step, gap) == 1) == LineString(step).crosses(LineString(gap))


def test_a_robot_that_stands_leaves_one_place_and_old_places_are_forgotten():
    trail = Trail()
    for step in range(20):
        trail.add(step, 3, np.array([1.0, 2.0, 0.1 * step]), LIMITS)
    assert len(trail.places) == 2
    for step in range(20, 20 + 2 * MOST):
        trail.add(step, 5, np.array([1.0 + 0.2 * (step - 19), 2.0, 0.0]), LIMITS)
    assert len(trail.places) == MOST + 1
    assert trail.places[-1, 2:].tolist() == [19 + 2 * MOST, 5]
