"""Compiled functions of the ground-truth metrics: pose errors, seen area, pairs and their scores.

When the estimate of an episode or drive counts as lost: one definition for every table.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.carriers import Array, Bools, Bytes, Ints
from mecp_env.core.jit import compiled
from mecp_env.core.linalg import factor_lower, solve_lower
from mecp_env.core.se2 import polar_to_points, to_map, wrap_angle
from mecp_env.slam.messages import Cell, Decision
from mecp_env.world.laser import line_of_sight

CELL_M = 0.1  # of the rasters: finer than the thinnest wall, so that a cell seen is a cell on this side
STEP = 0.9  # cells between two looks along a beam
LANDMARK = int(Decision.LANDMARK)
FREE, OCCUPIED, DOOR = int(Cell.FREE), int(Cell.OCCUPIED), int(Cell.DOOR)
NEES_MAX = 1e9
BESIDE_M = 0.15  # distance from dynamic obstacles: a landmark there may be on one
WALL_M = 0.25  # distance from a true wall within which it is in the map
BORDER = 3  # depth of a cell beside one of another room


@compiled
def pose_errors(T_map_robot: Array, believed: Array, cov: Array) -> tuple[float, float, float]:
    """Position error (m), heading error (rad) and NEES of the estimated pose (3,).

    The NEES, the normalised squared error under the covariance (3,3), is 0 at an exact pose and at most 1e9, also where
    the filter diverged and its covariance is no longer positive.
    """
    error = np.empty(3)
    for i in range(3):
        error[i] = T_map_robot[i] - believed[i]
    error[2] = wrap_angle(error[2])
    L, nees = cov.copy(), 0.0
    if error[0] != 0.0 or error[1] != 0.0 or error[2] != 0.0:
        if factor_lower(L):
            y = solve_lower(L, error)
            nees = min(y[0] * y[0] + y[1] * y[1] + y[2] * y[2], NEES_MAX)
        else:
            nees = NEES_MAX
    return math.sqrt(error[0] * error[0] + error[1] * error[1]), abs(error[2]), nees


@compiled
def identify_corners(z: Array, T_world_robot: Array, true: Array, segments: Array, gate: float) -> Ints:
    """(n,) index of the true corner (m,2) that each corner z (n,2) of a scan is, or -1: nearest first, one to one.

    Only true corners within `gate` metres and in sight from the pose count.
    """
    seen = to_map(T_world_robot, polar_to_points(z))
    n, m, count = seen.shape[0], true.shape[0], 0
    apart, row, column = np.empty(n * m), np.empty(n * m, np.int64), np.empty(n * m, np.int64)  # of near pairs
    for j in range(m):
        before = count
        for i in range(n):
            square = (seen[i, 0] - true[j, 0]) ** 2 + (seen[i, 1] - true[j, 1]) ** 2
            if square < gate * gate:
                apart[count], row[count], column[count] = square, i, j
                count += 1
        if count > before and not line_of_sight(segments, T_world_robot[0], T_world_robot[1], true[j : j + 1])[0]:
            count = before
    identity, taken = np.full(n, -1), np.zeros(m, np.bool_)
    for k in np.argsort(apart[:count]):
        if identity[row[k]] < 0 and not taken[column[k]]:
            identity[row[k]] = column[k]
            taken[column[k]] = True
    return identity


@compiled
def sweep(ranges: Array, directions: Array, p_world: Array, corner: Array, free: Bools, seen: Bools) -> int:
    """Mark in `seen` (H,W) the free cells under the beams (B,) along `directions` (2,B); how many are new.

    Ranges and the robot's place `p_world` are in metres; `corner` (2,) is the lower left one of the rasters.
    """
    x, y = (p_world[0] - corner[0]) / CELL_M, (p_world[1] - corner[1]) / CELL_M
    spacing, new = 2.0 * math.pi / ranges.shape[0], 0
    for b in range(ranges.shape[0]):
        stride = (b + 1) & -(b + 1)  # the largest power of two that divides it
        # nearer in than the first ring, the neighbours of a beam cover every cell already
        far, r = ranges[b] / CELL_M - 0.1, 0.0 if stride >= 4096 else STEP / (2.0 * stride * spacing)
        dx, dy = directions[0, b], directions[1, b]
        while r < far + STEP:
            reach, r = min(r, far), r + STEP
            u, v = x + dx * reach, y + dy * reach
            if u < 0.0 or v < 0.0 or u >= seen.shape[1] or v >= seen.shape[0]:
                continue
            i, j = np.uint64(v), np.uint64(u)  # which numba does not ask for being negative
            if free[i, j] and not seen[i, j]:
                seen[i, j] = True
                new += 1
    return new


@compiled
def score_scan(
    votes: NDArray[np.int32],
    features: Ints,
    rows: Ints,
    counts: Ints,
    ids: Ints,
    decision: Ints,
    landmarks: Ints,
    step: int,
) -> int:
    """Count the corners of a scan as true and false positives, false and true negatives in `counts` (4,).

    `rows` (n,4) hold the true corners in column 1; step, feature and matched to a landmark are filled in. `features`
    (F,2) hold the identity of each feature (the majority of its `votes` (F,G), this scan's included) and the step in
    which it became a landmark, for new `landmarks` (N,) this one. A corner that is named as one of
    them, but not matched to it (a post, where posts are no landmarks), is not missed. Returns the largest id; where the
    tables have no row for it, nothing is counted.
    """
    most = -1
    for i in range(rows.shape[0]):
        rows[i, 0], rows[i, 2], rows[i, 3] = step, ids[i], decision[i] == LANDMARK
        most = max(most, ids[i])
    for i in range(landmarks.shape[0]):
        most = max(most, landmarks[i])
    if most >= features.shape[0]:
        return most
    for i in range(rows.shape[0]):
        corner, feature = rows[i, 1], rows[i, 2]
        if feature >= 0 and corner >= 0:
            votes[feature, corner] += 1
            best = features[feature, 0]
            if best < 0 or votes[feature, corner] > votes[feature, best]:
                features[feature, 0] = corner
    known = np.zeros(votes.shape[1], np.bool_)  # the true corners that had a landmark before this scan
    for feature in range(features.shape[0]):
        if features[feature, 0] >= 0 and features[feature, 1] < step:
            known[features[feature, 0]] = True
    for i in range(rows.shape[0]):
        corner, feature = rows[i, 1], rows[i, 2]
        if rows[i, 3]:
            right = corner >= 0 and features[feature, 0] == corner
            counts[0 if right else 1] += 1
        else:
            missed = corner >= 0 and known[corner] and not (feature >= 0 and features[feature, 1] < step)
            counts[2 if missed else 3] += 1
    for i in range(landmarks.shape[0]):
        features[landmarks[i], 1] = min(features[landmarks[i], 1], step)
    return most


@compiled
def room_middles(room: NDArray[np.int16], rooms: Ints) -> Array:
    """(n,2) column and row of the cell of each room (n,) farthest from all that is not of it, nan for none.

    The distances (chamfer, in thirds of a cell) grow on the way to the last cell, and are completed on the way back.
    """
    most, middles = 0, np.empty((rooms.shape[0], 2))
    for k in range(rooms.shape[0]):
        most = max(most, rooms[k] + 1)
    height, width = room.shape
    depth = np.empty(room.shape, np.int32)
    for i in range(height):
        for j in range(width):
            depth[i, j] = BORDER
    inside = np.empty(width, np.bool_)
    for i in range(1, height - 1):
        left, here, right = room[i], room[i, 1:], room[i, 2:]  # counted from 0, so that many cells are done at a time
        above, below, row, before = room[i - 1, 1:], room[i + 1, 1:], depth[i, 1:], depth[i - 1]
        for j in range(width - 2):
            r = here[j]
            inside[j] = (r >= 0) & (r == left[j]) & (r == right[j]) & (r == above[j]) & (r == below[j])
        for j in range(width - 2):
            if inside[j]:
                row[j] = min(min(depth[i, j], before[j + 1]) + 3, min(before[j], before[j + 2]) + 4)
    deepest = np.full((most, 3), np.nan)  # depth, column and row
    deepest[:, 0] = 0.0
    for i in range(room.shape[0] - 1, -1, -1):
        for j in range(room.shape[1] - 1, -1, -1):
            r = room[i, j]
            if r < 0 or r >= most:
                continue
            if depth[i, j] > BORDER:
                straight = min(depth[i, j + 1], depth[i + 1, j])
                slanting = min(depth[i + 1, j + 1], depth[i + 1, j - 1])
                depth[i, j] = min(depth[i, j], straight + 3, slanting + 4)
            if depth[i, j] >= deepest[r, 0]:
                deepest[r, 0], deepest[r, 1], deepest[r, 2] = depth[i, j], j, i
    for k in range(rooms.shape[0]):
        middles[k, 0], middles[k, 1] = deepest[rooms[k], 1], deepest[rooms[k], 2]
    return middles


@compiled
def mark_discs(cells: Bools, corner: Array, walking: Array) -> None:
    """Mark the cells (H,W) whose middle lies within `BESIDE_M` of a dynamic obstacle: place and reach (n,3) m."""
    for i in range(walking.shape[0]):
        x, y = (walking[i, 0] - corner[0]) / CELL_M, (walking[i, 1] - corner[1]) / CELL_M
        radius = (walking[i, 2] + BESIDE_M) / CELL_M
        for row in range(max(math.floor(y - radius), 0), min(math.floor(y + radius) + 1, cells.shape[0])):
            for column in range(max(math.floor(x - radius), 0), min(math.floor(x + radius) + 1, cells.shape[1])):
                cells[row, column] |= (column + 0.5 - x) ** 2 + (row + 0.5 - y) ** 2 < radius * radius


@compiled
def count_correct(p_world: Array, wall: Ints, p_walls: Array, T_map_world: Array, label: Bytes, place: Array) -> int:
    """How many of the places (n,2) are FREE or DOOR in a grid, and their wall, of `p_walls` (w,2), is in the grid.

    `place` (3,): the lower left corner of the grid `label` (H,W) in the map frame and the size of its cells, m.
    """
    cells, walls, reach = to_map(T_map_world, p_world), to_map(T_map_world, p_walls), WALL_M / place[2]
    asked, known = np.zeros(walls.shape[0], np.bool_), np.zeros(walls.shape[0], np.bool_)
    beside, count, correct = np.empty(cells.shape[0], np.int64), 0, 0  # the walls of the cells that are mapped
    for k in range(cells.shape[0]):
        i, j = math.floor((cells[k, 1] - place[1]) / place[2]), math.floor((cells[k, 0] - place[0]) / place[2])
        if i >= 0 and j >= 0 and i < label.shape[0] and j < label.shape[1]:
            beside[count] = wall[k]
            if label[i, j] == FREE or label[i, j] == DOOR:
                asked[wall[k]] = True
                count += 1
    for k in range(walls.shape[0]):
        x, y = (walls[k, 0] - place[0]) / place[2], (walls[k, 1] - place[1]) / place[2]
        rows = min(math.floor(y + reach) + 1, label.shape[0]) if asked[k] else 0
        for i in range(max(math.floor(y - reach), 0), rows):
            for j in range(max(math.floor(x - reach), 0), min(math.floor(x + reach) + 1, label.shape[1])):
                if label[i, j] == OCCUPIED and (j + 0.5 - x) ** 2 + (i + 0.5 - y) ** 2 <= reach * reach:
                    known[k] = True
                    break
            if known[k]:
                break
    for k in range(count):
        correct += known[beside[k]]
    return correct


LOST_M = 1.0
LOST_DEG = 10.0
LOST_STEPS = 20


@dataclass(slots=True, eq=False)
class LostWatch:
    """Whether the estimate of an episode or drive counts as lost, as far as it has come; plain state."""

    off_steps: int = 0  # in a row, up to now
    longest: int = 0  # of all such rows

    def look(self, error_m: float, error_rad: float) -> None:
        """Count one step: the pose is off by more than 1 m or 10 degrees, or it is not."""
        off = error_m > LOST_M or abs(error_rad) > math.radians(LOST_DEG)
        self.off_steps = self.off_steps + 1 if off else 0
        self.longest = max(self.longest, self.off_steps)

    def is_lost(self, diverged: bool) -> bool:
        """True when the pose was off for 20 steps in a row, is off in the last one, or has `diverged`."""
        return diverged or self.off_steps > 0 or self.longest >= LOST_STEPS
