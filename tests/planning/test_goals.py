"""Goals: kinds, order, closing and giving up."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapely

from mecp_env.core.se2 import to_map, to_robot
from mecp_env.planning.config import GoalsConfig, PlanningConfig
from mecp_env.planning.goal_search import BARRIER_CELLS, assign_rooms, far_apart, looked_at, near_lines
from mecp_env.planning.goal_sources import (
    GoalContext,
    barriers,
    candidate_goals,
    door_goals,
    find_everything,
    floor_goals,
    gap_goals,
    open_goals,
)
from mecp_env.planning.goals import (
    Goal,
    GoalHistory,
    GoalKind,
    Goals,
    Outcome,
    complete_rooms,
    door_levels,
    find_goals,
    levels_from,
    polygon_levels,
    with_gaps,
)
from mecp_env.planning.navigator import Target, settled
from mecp_env.slam.messages import Cell, EdgeLabel
from mecp_env.slam.output import SlamOutput
from tests.slam import make
from tests.toy import Toy, layer_at

CONFIG = PlanningConfig()


def from_source(source: Any, output: SlamOutput, **config: float) -> Goals:
    """The goals of one source."""
    found = source(GoalContext.of(output), GoalsConfig(**config))
    return Goals.of(found[1] if source is floor_goals else found)


def half_a_room(toy: Toy) -> None:
    """A polygon of the west half of room A, whose edge in the middle is open."""
    toy.p_map[1:3] = to_map(toy.T_map_world, np.array([[3.0, 0.0], [3.0, 4.0]]))
    toy.add_polygon([0, 1, 2, 3], 0, open_edges=(1,))


@pytest.fixture(params=[np.zeros(3), np.array([2.0, -1.0, 2.5])])
def toy(request: pytest.FixtureRequest) -> Toy:
    return Toy(np.array([1.0, 2.0, 0.0]), request.param)


def test_cells_near_lines_are_those_within_the_margin() -> None:
    ends = np.random.default_rng(0).uniform(-4.0, 44.0, (6, 2, 2))
    ends[4, 1], ends[5] = ends[4, 0], np.nan  # a point, and a door without its jambs
    cells = shapely.points(np.stack(np.meshgrid(np.arange(40), np.arange(30)), axis=-1) + 0.5)
    near = shapely.distance(shapely.MultiLineString(ends[:5].tolist()), cells) < 2.3
    assert near.any()
    np.testing.assert_array_equal(near_lines((30, 40), ends, 2.3), near)


def test_an_open_edge_has_a_goal_beyond_its_middle_until_a_polygon_closes_it(toy: Toy) -> None:
    half_a_room(toy)
    output = toy.output()
    goals = from_source(open_goals, output)
    assert to_robot(toy.T_map_world, goals.p_map) == pytest.approx(np.array([[3.4, 2.0]]))
    assert goals.size_m == pytest.approx([4.0])
    assert not from_source(open_goals, output, open_width_m=4.5)  # too narrow
    target = Target.of(goals, 0)
    assert not settled(target, output, CONFIG.goals)  # though the floor there is seen
    toy.p_map[8] = to_map(toy.T_map_world, np.array([[5.9, 2.0]]))[0]
    toy.add_polygon([1, 8, 2], 0)
    assert not from_source(open_goals, toy.output())
    assert settled(target, toy.output(), CONFIG.goals)


def test_places_are_looked_at_from_near_where_no_wall_is_between_and_the_laser_sees() -> None:
    label = np.full((40, 40), Cell.FREE, np.uint8)
    label[:, 20] = Cell.OCCUPIED
    floor, scans = (label, np.array([-1.0, 0.0]), 0.1), np.array([[0.5, 1.0, 2.0], [-0.8, 3.0, 0.0]])
    places = np.array([[0.9, 1.0], [1.4, 1.0], [-0.6, 1.0], [0.2, 1.3], [-0.8, 3.0]])  # the second behind the wall

    def seen(*field: float, room: int = 0, scans: np.ndarray = scans) -> list[bool]:
        rooms = np.full(5, 1), np.full(len(scans), room)
        return looked_at(places, rooms[0], (scans, rooms[1]), 1.0, field, floor).tolist()  # type: ignore[arg-type]

    assert seen(0.0, math.pi) == [True, False, False, True, True]
    assert seen(0.0, math.pi, room=1) == [True, True, False, True, True]  # a goal in the wall of its room
    assert seen(0.0, 0.5 * math.pi) == [False, False, False, True, True]
    assert seen(-2.0, 0.5 * math.pi) == [True, False, False, False, False]
    assert seen(0.0, math.pi, scans=np.empty((0, 3))) == [False] * 5


def test_where_the_robot_has_been_no_open_edge_of_a_room_that_it_left_is_a_goal(toy: Toy) -> None:
    half_a_room(toy)
    output, limits = toy.output(), CONFIG.goals

    def kinds(*T_map_scans: np.ndarray, current: int = 1) -> list[int]:
        scans = {"T_map_scans": np.reshape(T_map_scans, (-1, 3)), "scan_rooms": np.zeros(len(T_map_scans), int)}
        seen = replace(output, graph=make.graph(current, (0, 1), doors=output.graph.doors), **scans)
        return [goal.kind for goal in find_everything(GoalContext.of(seen), {}, limits)]

    (there,) = from_source(open_goals, output).p_map
    near, far = (np.array([there[0] + m * limits.seen_m, there[1], 0.0]) for m in (0.9, 1.1))
    assert GoalKind.OPEN in kinds()
    assert GoalKind.OPEN in kinds(far)
    assert kinds(far, near) == [kind for kind in kinds() if kind != GoalKind.OPEN]  # all else stays
    assert GoalKind.OPEN in kinds(near, current=0)


def test_a_candidate_is_looked_at_from_inside_the_room(toy: Toy) -> None:
    toy.confirmed = False
    output = toy.output()
    goals = from_source(candidate_goals, output)
    assert to_robot(toy.T_map_world, goals.p_map) == pytest.approx(np.array([[4.5, 1.95]]))
    target = Target.of(goals, 0)
    assert not settled(target, output, CONFIG.goals)
    toy.confirmed = True
    assert settled(target, toy.output(), CONFIG.goals)
    merged = make.graph(candidates=(make.candidate(toy.p_map[[4, 5]], 4),), merged={4: 0})
    assert from_source(candidate_goals, replace(output, graph=merged)).room.tolist() == [0]


def test_in_a_narrow_corridor_a_candidate_is_looked_at_from_this_side_of_the_wall(toy: Toy) -> None:
    toy.confirmed = False
    output = toy.output()
    wall = to_map(toy.T_map_world, np.column_stack((np.full(50, 5.0), np.linspace(1.5, 2.5, 50))))  # 1 m from the gap
    column, row = np.floor((wall - output.grid.origin) / output.grid.resolution_m).astype(int).T
    label = output.grid.label.copy()
    label[row, column] = Cell.OCCUPIED
    goals = from_source(candidate_goals, replace(output, grid=replace(output.grid, label=label)))
    assert to_robot(toy.T_map_world, goals.p_map) == pytest.approx(np.array([[5.5, 1.95]]), abs=0.06)


def with_gap(toy: Toy, edge: int) -> SlamOutput:
    """What is reported when the polygon of room A has a gap in an edge, and neither door nor candidate is known."""
    toy.polygons[:] = [make.map_polygon([0, 1, 2, 3], 0, np.array([[edge, 0.4, 0.6, EdgeLabel.GAP]]))]
    return replace(toy.output(), graph=make.graph())


def test_a_gap_that_nothing_explains_is_looked_at_when_nothing_else_is_left(toy: Toy) -> None:
    """Seen in a building: a corridor that one polygon covers, and a door in its wall that was seen from the side."""
    toy.T_world_robot = np.array([3.0, 2.0, 0.0])
    toy.output()
    output = with_gap(toy, edge=1)  # the door's
    goals = find_goals(output, GoalHistory(), CONFIG)
    assert goals.kind.tolist() == [GoalKind.CANDIDATE]
    assert to_robot(toy.T_map_world, goals.p_map) == pytest.approx(np.array([[4.5, 2.0]]), abs=0.01)
    target, history = Target.of(goals, 0), GoalHistory()
    assert not settled(target, output, CONFIG.goals)
    for outcome, left in ((Outcome.REFUSED, 1), (Outcome.REACHED, 0)):  # one look is enough
        history.record(goals, 0, outcome, CONFIG.goals)
        assert len(find_goals(output, history, CONFIG)) == left
    known = toy.output()  # of the door
    assert gap_goals(GoalContext.of(known), CONFIG.goals) == []
    assert find_goals(known, GoalHistory(), CONFIG).kind.tolist() == [GoalKind.DOOR]
    assert settled(target, known, CONFIG.goals)
    assert gap_goals(GoalContext.of(with_gap(toy, edge=3)), CONFIG.goals) == []  # before a wall


def test_gaps_of_the_robots_room_come_before_it_is_left_and_others_last(toy: Toy) -> None:
    toy.T_world_robot = np.array([3.0, 2.0, 0.0])
    toy.output()
    inside, history = with_gap(toy, edge=1), GoalHistory()
    outside = replace(inside, graph=make.graph(1, (0, 1)))
    kinds = (GoalKind.DOOR, 0), (GoalKind.FRONTIER, 1), (GoalKind.OPEN, 0)
    door, elsewhere, here = (Goal(kind, 1.0, 1.0, 1.0, room) for kind, room in kinds)
    for output, found, added in (
        *((inside, [door], 1), (inside, [elsewhere], 1), (inside, [door, here], 0), (inside, [], 1)),
        *((outside, [door], 0), (outside, [elsewhere], 0), (outside, [], 1)),
    ):
        assert len(with_gaps(found, GoalContext.of(output), history, CONFIG)) == len(found) + added


def test_what_was_looked_for_in_vain_in_one_room_is_a_goal_of_the_next(toy: Toy) -> None:
    history = GoalHistory()
    goals = find_goals(toy.output(), history, CONFIG)
    for _ in range(CONFIG.goals.visits):
        history.record(goals, 0, Outcome.REACHED, CONFIG.goals)
    place = tuple(goals.p_map[0].tolist())
    found = history.find(goals.kind[0], 0, place, 0.5)
    assert found is not None
    assert found.closed
    assert history.find(goals.kind[0], 1, place, 0.5) is None
    history.notice(replace(toy.output(), graph=make.graph(1, (1,), merged={0: 1})))
    assert history.find(goals.kind[0], 1, place, 0.5) is found


def test_no_goal_stays_given_up_for_a_wrong_pose(toy: Toy) -> None:
    history, found = GoalHistory(), toy.output()
    lost = replace(found, localised=False)
    goals = find_goals(found, history, CONFIG)
    for output in (found, lost, found):  # the pose is right, lost, and found again
        assert not history.drives
        for seen in (output, output):
            history.notice(seen)
            history.record(goals, 0, Outcome.REACHED, CONFIG.goals)
        assert len(find_goals(output, history, CONFIG)) < len(goals)
        while output is lost and (left := find_goals(output, history, CONFIG)) and history.drives:
            history.record(left, 0, Outcome.REACHED, CONFIG.goals)  # until none is left: all are offered again
        assert len(find_goals(output, history, CONFIG)) == len(goals) - (output is found)
        history.notice(lost if output is found else found)


def test_an_unexplored_door_has_a_goal_beyond_it(toy: Toy) -> None:
    goals = from_source(door_goals, toy.output())
    assert to_robot(toy.T_map_world, goals.p_map) == pytest.approx(np.array([[6.96, 1.95]]))
    assert goals.size_m == pytest.approx([0.9])
    toy.T_world_robot[0] = 7.0
    assert not from_source(door_goals, toy.output())


def test_frontiers_lie_in_the_room_and_not_at_the_door(toy: Toy) -> None:
    assert not from_source(floor_goals, toy.output())  # all of room A is seen; no room beyond the door is known
    toy.T_world_robot = np.array([8.0, 2.0, 0.0])
    goals = from_source(floor_goals, toy.output())
    assert len(goals)
    assert (to_robot(toy.T_map_world, goals.p_map)[:, 0] > 11.0).all()
    assert (goals.room == 1).all()


def test_floor_seen_from_outside_joins_its_room_but_not_across_a_door(toy: Toy) -> None:
    def assigned(output: SlamOutput, *p_world: tuple[float, float]) -> list[int]:
        found = assign_rooms(output.grid.label, output.grid.room, barriers(GoalContext.of(output)), BARRIER_CELLS)
        return layer_at(output.grid, found, to_map(toy.T_map_world, np.array(p_world))).tolist()

    toy.T_world_robot = np.array([4.0, 1.95, 0.0])
    assert assigned(toy.output(), (8.0, 1.95)) == [-1]
    toy.T_world_robot = np.array([7.0, 3.6, 0.0])
    output = toy.output()
    room = np.full_like(output.grid.room, -1)  # as if only a patch of room B had its room
    column, row = ((to_map(toy.T_map_world, np.array([[7.5, 3.0]]))[0] - output.grid.origin) / 0.1).astype(int)
    room[row, column] = 1
    patchy = replace(output, grid=replace(output.grid, room=room, version=99))
    assert assigned(patchy, (8.0, 1.95), (12.0, 3.0), (5.0, 1.95), (1.0, 1.0)) == [1, 1, -1, -1]


def test_the_list_is_complete_only_when_nothing_is_left(toy: Toy) -> None:
    history = GoalHistory()
    goals = find_goals(toy.output(), history, CONFIG)
    assert set(goals.kind.tolist()) == {GoalKind.OPEN, GoalKind.DOOR}  # a room without a polygon is a goal
    assert to_robot(toy.T_map_world, goals.p_map)[0] == pytest.approx([3.0, 2.0], abs=0.3)  # the middle of the floor
    toy.add_polygon([0, 1, 2, 3], 0)
    goals = find_goals(toy.output(), history, CONFIG)
    assert goals.kind.tolist() == [GoalKind.DOOR]
    assert goals.path_m == pytest.approx([5.8], abs=1.2)  # to the near side of what can be reached, 5.76 m away
    assert complete_rooms(goals, history, toy.graph()) == (0,)
    toy.add_polygon([8, 9, 10, 11], 1)
    for x in (*np.arange(7.0, 31.0, 1.0), *np.arange(31.0, 11.0, -1.0)):
        toy.T_world_robot = np.array([x, 1.2 if toy.T_world_robot[0] < x else 2.9, 0.0])
        toy.output()
    assert not find_goals(toy.output(), history, CONFIG)
    assert complete_rooms(goals, history, toy.graph()) == (0, 1)


def test_a_known_room_entered_by_another_door_is_a_goal_until_a_polygon_tells(toy: Toy) -> None:
    toy.add_polygon([8, 9, 10, 11], 3)  # room B, known from elsewhere as room 3; the robot comes to it as room 1
    toy.T_world_robot = np.array([6.6, 1.95, 0.0])
    output, history = toy.output(), GoalHistory()
    goals = find_goals(output, history, CONFIG)
    row = goals.room.tolist().index(1)
    assert goals.kind[row] == GoalKind.OPEN
    assert to_robot(toy.T_map_world, goals.p_map)[row] == pytest.approx([7.6, 1.95])
    assert not settled(Target.of(goals, row), output, CONFIG.goals)
    output = replace(output, graph=make.graph(3, (0, 3), doors=output.graph.doors, merged={1: 3}))
    assert settled(Target.of(goals, row), output, CONFIG.goals)
    assert GoalKind.OPEN not in find_goals(output, history, CONFIG).kind


def test_refused_thrice_or_visited_in_vain_is_given_up(toy: Toy) -> None:
    toy.add_polygon([0, 1, 2, 3], 0)
    limits = CONFIG.goals
    often = {Outcome.REFUSED: limits.refusals, Outcome.REACHED: limits.visits, Outcome.SETTLED: limits.settled}
    for ended, times in often.items():
        history = GoalHistory()
        for drive in range(times):
            found = find_goals(toy.output(), history, CONFIG)
            assert found.visits.tolist() == [drive]
            history.record(found, 0, ended, limits)
        assert not find_goals(toy.output(), history, CONFIG)


@pytest.mark.parametrize("kind", [GoalKind.OPEN, GoalKind.CANDIDATE, GoalKind.FRONTIER, GoalKind.DOOR])
def test_an_open_edge_is_visited_once_and_all_else_again(kind: GoalKind) -> None:
    goals, history = Goals.of([Goal(kind, 1.0, 1.0, 1.0, 0)]), GoalHistory()
    assert history.record(goals, 0, Outcome.REACHED, CONFIG.goals).closed == (kind == GoalKind.OPEN)
    assert history.record(goals, 0, Outcome.REACHED, CONFIG.goals).closed


@pytest.mark.parametrize("kind", [GoalKind.CANDIDATE, GoalKind.DOOR])
def test_what_is_out_of_reach_is_a_goal_until_it_is_closed_but_waits_for_all_others(kind: GoalKind) -> None:
    """Seen in a home: behind a narrow door the path back was blocked, and the exploration terminated as complete."""
    toy, history = Toy(np.array([3.0, 2.0, 0.0]), confirmed=kind == GoalKind.DOOR), GoalHistory()
    narrow = PlanningConfig(paths={"radius_m": 1.7}, goals={"reach_m": 0.1})
    assert find_goals(toy.output(), history, narrow).kind.tolist() == [GoalKind.OPEN]  # the floor is in reach
    toy.add_polygon([0, 1, 2, 3], 0)
    for drive in range(narrow.goals.refusals):
        goals = find_goals(toy.output(), history, narrow)
        assert (goals.kind.tolist(), goals.visits.tolist()) == ([kind], [drive])
        assert goals.path_m == pytest.approx(np.hypot(*(goals.p_map - toy.output().belief.T_map_robot[:2]).T))
        history.record(goals, 0, Outcome.REFUSED, narrow.goals)
    assert not find_goals(toy.output(), history, narrow)


def test_rooms_have_the_level_of_the_door_graph() -> None:
    doors = tuple(make.door(i, rooms=rooms) for i, rooms in enumerate([(0, 1), (1, 2), (0, 3), (3, -1), (5, 2)]))
    graph = make.graph(0, (0, 1, 2, 3, 5), doors=doors, merged={4: 2})
    assert door_levels(graph, 0) == {0: 0, 1: 1, 3: 1, 2: 2, 5: 3}


@pytest.mark.parametrize("seed", range(2))
def test_levels_of_polygons_are_those_of_their_graph(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ids, p_map = rng.permutation(60)[:50], rng.normal(size=(50, 2))  # ten ids are no landmarks
    rings = [rng.choice(60, rng.integers(3, 6), replace=False) for _ in range(40)]
    belief = make.belief(p_map=p_map, ids=ids)
    whole = [ring for ring in rings if set(ring) <= set(ids)]
    assert 3 < len(whole) < 40
    middles = np.array([p_map[[ids.tolist().index(i) for i in ring]].mean(axis=0) for ring in whole])
    beside = {a: {b for b, other in enumerate(whole) if set(ring) & set(other)} for a, ring in enumerate(whole)}
    for entry, start in ((None, 0), (p_map[3], int(np.hypot(*(middles - p_map[3]).T).argmin()))):
        centres, levels = polygon_levels(rings, belief, entry)
        np.testing.assert_allclose(centres, middles)
        expected = levels_from(start, beside)
        assert levels.tolist() == [expected.get(k, len(whole)) for k in range(len(whole))]
    assert all(len(none) == 0 for none in polygon_levels([], belief, None))


def test_places_are_apart_from_all_taken_before() -> None:
    places = np.random.default_rng(4).uniform(0.0, 4.0, size=(60, 2))
    taken: list[int] = []
    for i, place in enumerate(places):
        if all(np.hypot(*(place - places[k])) > 0.7 for k in taken):
            taken.append(i)
    assert far_apart(places, 0.7).tolist() == taken
    assert 5 < len(taken) < 50
    assert far_apart(np.empty((0, 2)), 0.7).tolist() == []


def test_what_was_refused_gets_two_more_chances_and_what_was_visited_in_vain_none(toy: Toy) -> None:
    goals, limits, history = find_goals(toy.output(), GoalHistory(), CONFIG), CONFIG.goals, GoalHistory()
    assert len(goals) > 1
    for _ in range(limits.visits):
        history.record(goals, 1, Outcome.REACHED, limits)
    for _ in range(3):
        assert len(find_goals(toy.output(), history, CONFIG)) == len(goals) - 1
        for _ in range(limits.refusals):
            history.record(goals, 0, Outcome.REFUSED, limits)
        assert len(find_goals(toy.output(), history, CONFIG)) == len(goals) - 2
        history.retry_refused(limits)
    assert len(find_goals(toy.output(), history, CONFIG)) == len(goals) - 2
