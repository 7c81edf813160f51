"""Goals on known ground: places where the robot may become surer of its pose, and waiting where it is."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.se2 import compose
from mecp_env.planning.config import KnownGroundConfig, PlanningConfig
from mecp_env.planning.goal_list import Goal, GoalKind, Goals, PlaceKind
from mecp_env.planning.goals import GoalHistory, reach_of
from mecp_env.planning.navigator import CostToGoField, cost_to_go_field
from mecp_env.planning.prediction import predict
from mecp_env.slam.messages import UNKNOWN_ROOM, Belief
from mecp_env.slam.output import SlamOutput

SPOT_POINTS = 5  # of the path travelled, from one spot that may be a place to the next
MOST_LOOPS = 3  # places that close a loop
NEAR_M = 1.0  # what is nearer to the robot is no place to drive to
LOOK_M, LOOK_DEG, KEEP_OFF_M = 3.0, 15.0, 0.6  # a look elsewhere: how far, how wide the way, how far from walls it ends
AHEAD = 0.3  # by which the way ahead is preferred to the way back
SIGHT_M = 4.0  # of the landmarks that make a spot a good one, at most


class Surroundings(NamedTuple):
    """What the search for known ground reads: SLAM output, memory of the drives, and the robot's path (n,2) m."""

    output: SlamOutput
    history: GoalHistory
    travelled: Array


def offered_goals(goals: Goals, around: Surroundings, config: PlanningConfig, rows: int) -> Goals | None:
    """The rows of the observation: goals of the exploration first, then known ground; None where it is not offered.

    Each has its predicted sigmas and gain. Where the exploration has too many goals, its last ones are left out.
    """
    output, ground = around.output, config.known_ground
    if not ground.is_offered or not output.grid.label.size:
        return None
    costs = cost_to_go_field(output.grid, output.belief.T_map_robot, config.paths)
    known = known_goals(around, costs, ground)
    offered = [*goals.rows(rows - len(known)), *known]
    predict(offered, [reach_of(goal.kind, config.goals) for goal in offered], costs, output.belief, config.prediction)
    return Goals.of(offered)


def known_goals(around: Surroundings, costs: CostToGoField, ground: KnownGroundConfig) -> list[Goal]:
    """Places to drive to, or open floor while the pose is searched for; then waiting."""
    output, (x, y, _) = around.output, around.output.belief.T_map_robot.tolist()
    waiting = [Goal(GoalKind.WAIT, x, y, 0.0, UNKNOWN_ROOM)] if ground.wait_steps else []
    if not output.localised:
        return [*look_goals(output), *waiting]
    around.history.remember_good_place(output.belief, ground.good_sigma_m)
    return [*known_places(around, costs, ground), *waiting]


def known_places(around: Surroundings, costs: CostToGoField, ground: KnownGroundConfig) -> list[Goal]:
    """Places on the path travelled that can be reached: the last good one, closures of loops, known landmarks.

    At most `ground.places`, `apart_m` from each other; one that was refused is left out.
    """
    output, history, travelled = around
    here, spots = output.belief.T_map_robot[:2], travelled[::-1][::SPOT_POINTS]
    far = np.hypot(*(spots - here).T)
    driven = np.append(0.0, np.cumsum(np.hypot(*np.diff(spots, axis=0).T)))  # m, since the robot was at each spot
    worth = landmark_information(spots, output.belief)
    within = (far > NEAR_M) & (far <= ground.around_m)
    loops = in_order(within & (driven >= ground.loop_m), far)
    marks = in_order(within & (worth > 0.0), -worth)
    found = [] if history.good_place is None else [place_goal(history.good_place, PlaceKind.GOOD, output)]
    found += [place_goal(spots[i], PlaceKind.LOOP, output) for i in apart(spots[loops], loops, ground)[:MOST_LOOPS]]
    found += [place_goal(spots[i], PlaceKind.LANDMARKS, output) for i in apart(spots[marks], marks, ground)]
    return reachable_places(found, history, costs, ground)


def look_goals(output: SlamOutput) -> list[Goal]:
    """The farthest open floor that the scan shows, at most 3 m away; nothing where all is near.

    It is relative to the robot, so that it is right also in a map frame that is not.
    """
    beams, half = output.beams, max(1, round(math.radians(LOOK_DEG) / (2.0 * math.pi) * len(output.beams.ranges)))
    around = np.take(beams.ranges, np.arange(-half, len(beams.ranges) + half), mode="wrap")
    open_m = np.lib.stride_tricks.sliding_window_view(around, 2 * half + 1).min(axis=1) - KEEP_OFF_M
    best = int(np.argmax(np.minimum(open_m, LOOK_M) * (1.0 + AHEAD * np.cos(beams.bearings))))
    far_m = min(float(open_m[best]), LOOK_M)
    if far_m < NEAR_M:
        return []
    T_map_laser = compose(output.belief.T_map_robot, output.T_robot_laser)
    bearing = T_map_laser[2] + beams.bearings[best]
    x, y = T_map_laser[:2] + far_m * np.array([math.cos(bearing), math.sin(bearing)])
    return [Goal(GoalKind.LOOK, float(x), float(y), 0.0, UNKNOWN_ROOM, path_m=far_m)]


def landmark_information(spots: Array, belief: Belief) -> Array:
    """(n,) 1/m^2, of spots (n,2): the sum of 1 / sigma^2 over the landmarks within 4 m."""
    known = 2.0 / np.maximum(np.trace(belief.covs, axis1=1, axis2=2), 1e-9)
    near = np.hypot(*(spots[:, None] - belief.p_map).transpose(2, 0, 1)) <= SIGHT_M
    worth: Array = near @ known
    return worth


def in_order(chosen: Array, key: Array) -> Ints:
    """(k,) the indices of the chosen spots (n,), the smallest key (n,) first."""
    index = np.flatnonzero(chosen)
    ordered: Ints = index[np.argsort(key[index], kind="stable")]
    return ordered


def apart(spots: Array, index: Ints, ground: KnownGroundConfig) -> list[int]:
    """Those of an `index` (k,) whose spot (k,2) is `apart_m` from that of each before; at most as many as places."""
    kept = list[int]()
    for k in range(len(spots)):
        if len(kept) < ground.places and all(math.dist(spots[k], spots[i]) >= ground.apart_m for i in kept):
            kept.append(k)
    return [int(index[k]) for k in kept]


def place_goal(p_map: Array, why: PlaceKind, output: SlamOutput) -> Goal:
    """A place (2,) m, map frame, as a goal of the room that it is in."""
    grid, (x, y) = output.grid, p_map.tolist()
    column, row = np.floor((p_map - grid.origin) / grid.resolution_m).astype(np.int64).tolist()
    inside = 0 <= row < grid.room.shape[0] and 0 <= column < grid.room.shape[1]
    room = int(grid.room[row, column]) if inside else UNKNOWN_ROOM
    return Goal(GoalKind.PLACE, x, y, 0.0, room, level=int(why))


def reachable_places(
    places: list[Goal], history: GoalHistory, costs: CostToGoField, ground: KnownGroundConfig
) -> list[Goal]:
    """The first places that can be reached, are apart from those before and were not refused."""
    lengths = costs.lengths_m([(place.x, place.y, NEAR_M) for place in places])
    memories = history.find_all(places, ground.apart_m)
    kept = list[Goal]()
    for place, length_m, memory in zip(places, lengths, memories, strict=True):
        beside = any(math.hypot(place.x - other.x, place.y - other.y) < ground.apart_m for other in kept)
        if length_m >= NEAR_M and not beside and not (memory is not None and memory.closed):
            place.path_m = length_m
            kept.append(place)
    return kept[: ground.places]
