"""Goals on known ground, where the robot may become surer of its pose, by a virtual filter along the path.

The landmarks are taken as the belief has them. Each waypoint adds the noise of the odometry; then the landmarks in view
correct the pose. How their errors depend on each other and on that of the pose is not known here, so that the
covariance of each is divided by a weight, and all weights sum to one half (covariance intersection; Julier and Uhlmann
1997): landmarks that were mapped from this very pose hardly correct it, better known ones do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Array, Bools, Bytes, Ints
from mecp_env.core.grid_paths import DCOL, DROW, Distances, clear_line
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import wrap_angle
from mecp_env.planning.config import KnownGroundConfig, PlanningConfig, PredictionConfig
from mecp_env.planning.goal_list import Goal, GoalKind, Goals, PlaceKind
from mecp_env.planning.goals import GoalHistory, reach_of
from mecp_env.planning.navigator import NEAR_M, CostToGoField, cost_to_go_field, open_floor
from mecp_env.slam.messages import UNKNOWN_ROOM, Belief
from mecp_env.slam.output import SlamOutput

SHORT_M = 0.5  # a landmark is in sight if the way to this far before it is free: it is on a wall
WEIGHTS = 0.5  # sum of the weights of the landmarks in view
SPOT_POINTS = 5  # of the path travelled, from one spot that may be a place to the next
MOST_LOOPS = 3  # places that close a loop
SIGHT_M = 4.0  # of the landmarks that make a spot a good one, at most


def predict(
    goals: Sequence[Goal], reach_m: Sequence[float], costs: CostToGoField, belief: Belief, config: PredictionConfig
) -> None:
    """Fill in what is predicted of the goals, to which paths come as near as `reach_m`: see `predict_arrivals`."""
    places = [np.array([goal.x, goal.y]) for goal in goals]
    ends = [costs.nearest(place, reach) or (-1, -1) for place, reach in zip(places, reach_m, strict=True)]
    p_cells = (belief.p_map - costs.grid.origin) / costs.grid.resolution_m
    arrivals = predict_arrivals(
        (costs.step, costs.clearance, costs.cost),
        np.array(ends, np.int64).reshape(-1, 2),
        costs.grid.resolution_m,
        (np.ascontiguousarray(belief.T_map_robot), np.ascontiguousarray(belief.pose_cov)),
        (np.ascontiguousarray(p_cells), np.ascontiguousarray(belief.covs)),
        config.numbers,
    )
    for goal, (sigma_m, sigma_rad, gain_nat) in zip(goals, arrivals.tolist(), strict=True):
        goal.sigma_m, goal.sigma_rad, goal.gain_nat = sigma_m, sigma_rad, gain_nat


@compiled
def predict_arrivals(
    field: tuple[Bytes, Distances, Bytes],
    goals: Ints,
    cell_m: float,
    pose: tuple[Array, Array],
    landmarks: tuple[Array, Array],
    noise: Array,
) -> Array:
    """(g,3) sigma of position (m) and heading (rad) on arrival at each goal, and what landmarks gain on the way (nat).

    `field`: step to each cell, clearance and cost (H,W) of the paths from the robot; `goals` (g,2) row and column, -1
    where there is no path: the prediction then is that of the pose. `pose` (3,) and covariance (3,3); `landmarks` (N,2)
    in cells, covariances (N,2,2) m^2. `noise`: see `PredictionConfig.numbers`. A landmark gains the decrease of
    its entropy by the first sighting, 0.5 log det(P) - 0.5 log det(P'), if the pose were independent of it.
    """
    step, clearance, cost = field
    arrivals, seen = np.zeros((goals.shape[0], 3)), np.zeros(landmarks[0].shape[0], np.bool_)
    for g in range(goals.shape[0]):
        P, heading = pose[1].copy(), pose[0][2]
        seen[:] = False
        path = waypoints(step, goals[g, 0], goals[g, 1], max(1, int(noise[6] / cell_m)))
        for k in range(path.shape[0]):
            if k:
                dy, dx = cell_m * (path[k, 0] - path[k - 1, 0]), cell_m * (path[k, 1] - path[k - 1, 1])
                onward = math.atan2(dy, dx)
                drive_on(P, dx, dy, abs(wrap_angle(onward - heading)), noise)
                heading = onward
            view = path[k], heading, cell_m
            arrivals[g, 2] += look_around(P, view, (clearance, cost), landmarks, seen, noise)
        arrivals[g, 0] = math.sqrt(max(0.5 * (P[0, 0] + P[1, 1]), 0.0))
        arrivals[g, 1] = math.sqrt(max(P[2, 2], 0.0))
    return arrivals


@compiled
def waypoints(step: Bytes, row: int, column: int, stride: int) -> Ints:
    """(n,2) row and column of the cells on the path to a cell, `stride` steps apart, from the robot on."""
    limit = step.shape[0] * step.shape[1]
    back, n, k = np.empty((limit // stride + 2, 2), np.int64), 0, 0
    while row >= 0:
        last = step[row, column] == 8
        if k % stride == 0 or last:
            back[n, 0], back[n, 1], n = row, column, n + 1
        if last:
            break
        way = step[row, column]
        row, column, k = row - DROW[way], column - DCOL[way], k + 1
    return back[:n][::-1]


@compiled
def drive_on(P: Array, dx: float, dy: float, turn: float, noise: Array) -> None:
    """Predict the covariance P (3,3) of a pose, in place, over a straight drive (dx, dy) m after a `turn` (rad)."""
    length = math.sqrt(dx * dx + dy * dy)
    path = length + noise[2] * turn / (0.5 * math.pi)  # m, a turn counts as a path
    a, b = -dy, dx  # d position / d heading
    xt, yt, tt = P[0, 2], P[1, 2], P[2, 2]
    P[0, 0] += 2.0 * a * xt + a * a * tt
    P[0, 1] += a * yt + b * xt + a * b * tt
    P[1, 1] += 2.0 * b * yt + b * b * tt
    P[0, 2] += a * tt
    P[1, 2] += b * tt
    along = noise[0] * noise[0] * path / max(length * length, 1e-12)
    P[0, 0] += along * dx * dx
    P[0, 1] += along * dx * dy
    P[1, 1] += along * dy * dy
    P[2, 2] += noise[1] * noise[1] * path
    P[1, 0], P[2, 0], P[2, 1] = P[0, 1], P[0, 2], P[1, 2]


@compiled
def look_around(
    P: Array,
    view: tuple[Ints, float, float],
    clear: tuple[Distances, Bytes],
    landmarks: tuple[Array, Array],
    seen: Bools,
    noise: Array,
) -> float:
    """Correct the covariance P (3,3) of a pose, in place, by the landmarks in view; what they gain (nat).

    `view`: cell of the robot (2,), heading, size of a cell in m; `clear`: clearance and cost (H,W). A landmark gains
    when it is first `seen` (N,).
    """
    p_cells, covs = landmarks
    visible, total, gain = np.empty(p_cells.shape[0], np.int64), 0.0, 0.0
    count = 0
    for i in range(p_cells.shape[0]):
        if in_sight(view, p_cells[i], clear, noise):
            visible[count], count = i, count + 1
            total += 1.0 / (covs[i, 0, 0] + covs[i, 1, 1])
    for i in visible[:count]:
        x, y = (p_cells[i, 0] - view[0][1] - 0.5) * view[2], (p_cells[i, 1] - view[0][0] - 0.5) * view[2]
        weight = WEIGHTS / ((covs[i, 0, 0] + covs[i, 1, 1]) * total)
        gained = correct_pose(P, (-y, x), covs[i], weight, noise[5])
        gain += 0.0 if seen[i] else gained
        seen[i] = True
    return gain


@compiled
def in_sight(view: tuple[Ints, float, float], p_cell: Array, clear: tuple[Distances, Bytes], noise: Array) -> bool:
    """True when a place (2,), in cells, is within the range and the field of view, and nothing known is before it."""
    cell, heading, cell_m = view
    x, y = p_cell[0] - cell[1] - 0.5, p_cell[1] - cell[0] - 0.5
    if max(abs(x), abs(y)) * cell_m > noise[3]:  # most landmarks, at a low cost
        return False
    far = math.hypot(x, y)
    if far * cell_m > noise[3] or abs(wrap_angle(math.atan2(y, x) - heading)) > 0.5 * noise[4]:
        return False
    part = max(0.0, 1.0 - SHORT_M / max(far * cell_m, 1e-9))
    before = np.array([int(cell[0] + 0.5 + part * y), int(cell[1] + 0.5 + part * x)])
    return bool(clear_line(clear[0], clear[1], cell, before, 0.0))


@compiled
def correct_pose(P: Array, lever: tuple[float, float], cov: Array, weight: float, sigma_m: float) -> float:
    """Correct the covariance P (3,3) of a pose, in place, by a landmark; what the landmark gains (nat).

    `lever` (2,) m: change of the landmark's place in the map per turn of the robot; `cov` (2,2) m^2 of the landmark, of
    which `weight` counts; `sigma_m` of the measurement. The gain is 0.5 log det(cov) - 0.5 log det(cov'), of a landmark
    that is independent of the pose.
    """
    PH, S = np.empty((3, 2)), np.empty((2, 2))
    for i in range(3):
        for j in range(2):
            PH[i, j] = P[i, j] + P[i, 2] * lever[j]
    for i in range(2):
        for j in range(2):
            S[i, j] = PH[i, j] + PH[2, j] * lever[i] + (sigma_m * sigma_m if i == j else 0.0)
    alone = S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]  # of a measurement of this landmark if its place were known
    both = (S[0, 0] + cov[0, 0]) * (S[1, 1] + cov[1, 1]) - (S[0, 1] + cov[0, 1]) * (S[1, 0] + cov[1, 0])
    for i in range(2):
        for j in range(2):
            S[i, j] += cov[i, j] / weight
    det = S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]
    for i in range(3):
        a = (PH[i, 0] * S[1, 1] - PH[i, 1] * S[1, 0]) / det
        b = (PH[i, 1] * S[0, 0] - PH[i, 0] * S[0, 1]) / det
        for j in range(i + 1):
            P[i, j] -= a * PH[j, 0] + b * PH[j, 1]
            P[j, i] = P[i, j]
    return 0.5 * math.log(both / alone)


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
    """The open floor that the scan shows, if there is any."""
    place = open_floor(output)
    if place is None:
        return []
    far_m = float(np.hypot(*(place - output.belief.T_map_robot[:2])))
    return [Goal(GoalKind.LOOK, float(place[0]), float(place[1]), 0.0, UNKNOWN_ROOM, path_m=far_m)]


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
