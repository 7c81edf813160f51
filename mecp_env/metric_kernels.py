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
def count_votes(votes: NDArray[np.int32], identity: Ints, ids: Ints, truth: Ints) -> None:
    """Let each corner (n,) of a scan vote for what its feature is: `identity` (F,) is the majority of `votes` (F,G)."""
    for i in range(ids.shape[0]):
        feature, corner = ids[i], truth[i]
        if feature >= 0 and corner >= 0:
            votes[feature, corner] += 1
            best = identity[feature]
            if best < 0 or votes[feature, corner] > votes[feature, best]:
                identity[feature] = corner


@kernel
def score(matched: Bools, ids: Ints, truth: Ints, identity: Ints, known: Bools) -> Ints:
    """(4,) true positives, false positives, false negatives and true negatives among the corners (n,) of a scan.

    `known` (G,) tells which true corners have a landmark.
    """
    counts = np.zeros(4, np.int64)
    for i in range(ids.shape[0]):
        if matched[i]:
            right = truth[i] >= 0 and identity[ids[i]] == truth[i]
            counts[0 if right else 1] += 1
        else:
            missed = truth[i] >= 0 and known[truth[i]]
            counts[2 if missed else 3] += 1
    return counts
