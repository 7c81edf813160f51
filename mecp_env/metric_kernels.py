"""Compiled kernels of the truth metrics: what the robot has seen, pairs and their score."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.kernel import kernel
from mecp_env.world.laser import line_of_sight

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

STEP = 0.9  # cells between two looks along a beam


@kernel
def pair_corners(seen: Array, true: Array, segments: Array, pose: Array, gate: float) -> Ints:
    """(n,) index of the true corner (m,2) that each seen one (n,2) is, or -1: nearest first, each true corner once.

    Only true corners within `gate` metres and in sight from `pose` count; all in the world frame.
    """
    n, m = seen.shape[0], true.shape[0]
    apart = np.full((n, m), np.inf)
    for j in range(m):
        hidden = False  # asked only about the corners that are near enough
        for i in range(n):
            dx, dy = seen[i, 0] - true[j, 0], seen[i, 1] - true[j, 1]
            if hidden or dx * dx + dy * dy >= gate * gate:
                continue
            hidden = not line_of_sight(segments, pose[0], pose[1], true[j : j + 1])[0]
            if not hidden:
                apart[i, j] = dx * dx + dy * dy
    identity = np.full(n, -1)
    for i in range(n):
        settle_row(apart, identity, i)
    return identity


@kernel
def settle_row(apart: Array, identity: Ints, row: int) -> None:
    """Pair `row` with its nearest free column; whoever is nearer to that column than its present owner takes it."""
    while row >= 0:
        best = np.inf
        column = -1
        for j in range(apart.shape[1]):
            if apart[row, j] < best:
                best, column = apart[row, j], j
        if column < 0:
            return
        owner = -1
        for i in range(identity.shape[0]):
            if identity[i] == column:
                owner = i
        if owner >= 0 and apart[owner, column] <= best:
            apart[row, column] = np.inf
            continue
        identity[row] = column
        if owner >= 0:
            identity[owner] = -1
            apart[owner, column] = np.inf
        row = owner


@kernel
def first_ring(beam: int, spacing: float, step: float) -> float:
    """Range from which beam number `beam` is needed: nearer in, its neighbours cover every cell already."""
    stride = 1
    while beam % (2 * stride) == 0 and stride < 4096:
        stride *= 2
    return 0.0 if stride >= 4096 else step / (2.0 * stride * spacing)


@kernel
def sweep(ranges: Array, directions: Array, at: Array, free: Bools, seen: Bools) -> int:
    """Mark in `seen` (H,W) the free cells under the beams (B,) along `directions` (2,B); how many are new.

    Ranges and the robot's place `at` (2,) are in cells of the raster, whose lower left corner is the origin.
    """
    rows, cols = seen.shape
    spacing, new = 2.0 * math.pi / ranges.shape[0], 0
    for b in range(ranges.shape[0]):
        far, r = ranges[b] - 0.1, first_ring(b + 1, spacing, STEP)
        while r < far + STEP:
            reach = min(r, far)
            u, v = at[0] + directions[0, b] * reach, at[1] + directions[1, b] * reach
            if u >= 0.0 and v >= 0.0 and u < cols and v < rows:
                i, j = int(v), int(u)
                new += free[i, j] and not seen[i, j]
                seen[i, j] |= free[i, j]
            r += STEP
    return new


@kernel
def count_votes(votes: NDArray[np.int32], features: Ints, rows: Ints) -> None:
    """Let each corner of a scan vote for what its feature is; see `score_scan` for the tables."""
    for i in range(rows.shape[0]):
        corner, feature = rows[i, 1], rows[i, 2]
        if feature >= 0 and corner >= 0:
            votes[feature, corner] += 1
            best = features[feature, 0]
            if best < 0 or votes[feature, corner] > votes[feature, best]:
                features[feature, 0] = corner


@kernel
def score_scan(votes: NDArray[np.int32], features: Ints, rows: Ints, counts: Ints) -> None:
    """Count the corners of a scan as true and false positives, false and true negatives in `counts` (4,).

    `rows` (n,4) hold period, true corner, feature, matched to a landmark; `features` (F,2) the identity of each feature
    (the majority of its `votes` (F,G), this scan's included) and the period in which it became a landmark.
    """
    count_votes(votes, features, rows)
    known = np.zeros(votes.shape[1], np.bool_)  # the true corners that had a landmark before this scan
    for feature in range(features.shape[0]):
        if features[feature, 0] >= 0 and features[feature, 1] < rows[0, 0]:
            known[features[feature, 0]] = True
    for i in range(rows.shape[0]):
        corner, feature = rows[i, 1], rows[i, 2]
        if rows[i, 3]:
            right = corner >= 0 and features[feature, 0] == corner
            counts[0 if right else 1] += 1
        else:
            missed = corner >= 0 and known[corner]
            counts[2 if missed else 3] += 1


@kernel
def count_duplicates(features: Ints, landmarks: Ints, corners: int) -> int:
    """How many of the landmarks (N,) are of one of the true `corners` that another landmark is of already."""
    taken = np.zeros(corners, np.bool_)
    duplicates = 0
    for i in range(landmarks.shape[0]):
        corner = features[landmarks[i], 0]
        if corner >= 0:
            duplicates += taken[corner]
            taken[corner] = True
    return duplicates


@kernel
def room_middles(room: NDArray[np.int16], rooms: Ints) -> Array:
    """(n,2) column and row of the cell of each room (n,) farthest from all that is not of it, nan for none."""
    most = 1 + max(int(rooms.max()), int(room.max()))
    middles, deepest = np.full((most + 1, 2), np.nan), np.zeros(most + 1, np.int64)
    depth = room_depths(room)
    for i in range(room.shape[0]):
        for j in range(room.shape[1]):
            r = room[i, j]  # -1, no room, is counted in the last row
            if depth[i, j] > deepest[r]:
                deepest[r], middles[r, 0], middles[r, 1] = depth[i, j], j, i
    return middles[rooms]


@kernel
def room_depths(room: NDArray[np.int16]) -> NDArray[np.int64]:
    """(H,W) distance of each cell from the nearest one of another room, or outside, in thirds of a cell (chamfer)."""
    height, width = room.shape
    depth = np.empty((height, width), np.int64)
    for i in range(height):
        for j in range(width):
            inner = 0 < i < height - 1 and 0 < j < width - 1
            for di, dj in ((0, -1), (-1, 0), (0, 1), (1, 0)):
                inner = inner and room[i + di, j + dj] == room[i, j]
            depth[i, j] = 3 * (height + width) if inner else 3
    for sweep in range(2):
        sign = 1 - 2 * sweep  # from the first row down, then from the last one up
        for k in range((height - 2) * (width - 2)):
            i, j = 1 + k // (width - 2), 1 + k % (width - 2)
            if sweep:
                i, j = height - 1 - i, width - 1 - j
            for di, dj, far in ((0, -1, 3), (-1, 0, 3), (-1, -1, 4), (-1, 1, 4)):
                depth[i, j] = min(depth[i, j], depth[i + sign * di, j + sign * dj] + far)
    return depth
