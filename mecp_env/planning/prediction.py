"""What a drive to a goal does to the uncertainty of the pose: a virtual filter along the path.

The landmarks are taken as the belief has them. Each waypoint adds the noise of the odometry; then the landmarks in view
correct the pose. How their errors depend on each other and on that of the pose is not known here, so that the
covariance of each is divided by a weight, and all weights sum to one half (covariance intersection; Julier and Uhlmann
1997): landmarks that were mapped from this very pose hardly correct it, better known ones do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mecp_env.core.carriers import Array, Bools, Bytes, Ints
from mecp_env.core.grid_paths import DCOL, DROW, Distances, clear_line
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import wrap_angle
from mecp_env.planning.config import PredictionConfig
from mecp_env.planning.goal_list import Goal
from mecp_env.planning.navigator import CostToGoField
from mecp_env.slam.messages import Belief

SHORT_M = 0.5  # a landmark is in sight if the way to this far before it is free: it is on a wall
WEIGHTS = 0.5  # sum of the weights of the landmarks in view


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
