"""The observation in arrays: name, unit and bounds of every column (see `Observer`), and the compiled functions."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.carriers import Array, Bools, Bytes, Ints
from mecp_env.core.jit import compiled

Floats = NDArray[np.float32]
Part = tuple[int, int, int, int]
Column = tuple[str, str, tuple[float, float]]  # name, unit ("" for a number without one), bounds

FREE, POLYGON, OCCUPIED, UNKNOWN, DOOR, ROOM, FRONTIER, PATH = (1 << bit for bit in range(8))
LANDMARKS, GOALS = 128, 32  # rows
LAYERS = ("free", "polygon", "occupied", "unknown", "door", "room", "frontier", "path")
EXTENT_M = 200.0  # bound of every position and length
COV_MAX = 100.0  # bound of every covariance (m^2, m rad, rad^2)

PLACE, LENGTH, COVARIANCE, VARIANCE = (-EXTENT_M, EXTENT_M), (0.0, EXTENT_M), (-COV_MAX, COV_MAX), (0.0, COV_MAX)
SHARE, DIRECTION, LABEL, ROOM_ID, PREDICTED_SIGMA = (0.0, 1.0), (-1.0, 1.0), (0.0, 255.0), (-1.0, 255.0), (0.0, 10.0)
IN_ROBOT_FRAME: tuple[Column, ...] = (("x, robot frame", "m", PLACE), ("y, robot frame", "m", PLACE))
IN_LAYERS: tuple[Column, ...] = tuple((f"{layer}, 255 where a cell has it", "", LABEL) for layer in LAYERS)
GOAL: tuple[Column, ...] = (
    *IN_ROBOT_FRAME,
    ("length of the path", "m", LENGTH),
    ("size", "m", LENGTH),
    ("kind: 0 open edge, 1 candidate door, 2 frontier, 3 door, 4 known ground, 5 wait, 6 look", "", (0.0, 6.0)),
    ("room, -1 unknown", "", ROOM_ID),
    ("level", "", LABEL),
    ("visits", "", LABEL),
    ("valid", "", SHARE),
)
PREDICTED: tuple[Column, ...] = (  # with observation={"uncertainty": True}
    ("predicted sigma of the position on arrival", "m", PREDICTED_SIGMA),
    ("predicted sigma of the heading on arrival", "rad", PREDICTED_SIGMA),
    ("predicted gain of landmark information", "nat", (0.0, 1000.0)),
)
COLUMNS: dict[str, tuple[Column, ...]] = {
    "budget": (("share of the step limit that is left", "", SHARE),),
    "pose": (
        ("x, map frame", "m", PLACE),
        ("y, map frame", "m", PLACE),
        ("cos of the heading", "", DIRECTION),
        ("sin of the heading", "", DIRECTION),
    ),
    "pose_cov": (
        ("xx", "m^2", VARIANCE),
        ("xy", "m^2", COVARIANCE),
        ("x heading", "m rad", COVARIANCE),
        ("yy", "m^2", VARIANCE),
        ("y heading", "m rad", COVARIANCE),
        ("heading heading", "rad^2", VARIANCE),
    ),
    "landmarks": (
        *IN_ROBOT_FRAME,
        ("covariance xx, robot frame", "m^2", VARIANCE),
        ("covariance xy, robot frame", "m^2", COVARIANCE),
        ("covariance yy, robot frame", "m^2", VARIANCE),
        ("room, -1 unknown", "", ROOM_ID),
        ("kind: 0 line crossing, 1 line end, 2 jamb", "", (0.0, 2.0)),
        ("valid", "", SHARE),
    ),
    "goals": (*GOAL, *PREDICTED),
    "localisation": (
        ("probability that the position error is below 0.5 m", "", SHARE),
        ("localised", "", SHARE),
        ("recent share of recognised corners", "", SHARE),
    ),
    "grid": IN_LAYERS,
    "map": IN_LAYERS,
    "scan": (("range of a merged beam, the maximum range without a hit", "m", LENGTH),),  # that is the bound
}


@compiled
def cell_codes(label: Bytes, polygon: Bools, room: NDArray[np.int16], current: int) -> Bytes:
    """(H,W) one bit a layer (the path left out) for each cell of the semantic grid; `label` (H+2,W+2) has a rim of 0.

    A door is free too; a frontier cell is FREE with an UNKNOWN cell (or the grid's border) above, below or beside it.
    """
    rows, cols = polygon.shape
    codes = np.empty((rows, cols), np.uint8)
    unknown_room = current < 0
    for i in range(rows):
        for j in range(cols):  # without branches, so that it is done for many cells at a time
            a = label[i + 1, j + 1]
            beside = (label[i, j + 1] == 0) | (label[i + 2, j + 1] == 0)
            beside |= (label[i + 1, j] == 0) | (label[i + 1, j + 2] == 0)
            mine = (room[i, j] == current) & (not unknown_room)
            code = FREE * (a & 1) | OCCUPIED * (a == 2) | UNKNOWN * (a == 0) | DOOR * (a == 3)  # FREE 1, DOOR 3
            codes[i, j] = code | POLYGON * polygon[i, j] | ROOM * mine | FRONTIER * ((a == 1) & beside)
    return codes


def pool_codes(codes: Bytes, width: int) -> Bytes:
    """(H+w-1,W+w-1) the bits of the `width` x `width` cells up to and with cell [i, j]; unknown outside the grid."""
    rim, rows, cols = width - 1, codes.shape[0] + width - 1, codes.shape[1] + width - 1
    padded = np.full((rows + rim, cols + rim), UNKNOWN, np.uint8)
    padded[rim:rows, rim:cols] = codes
    tall = functools.reduce(np.bitwise_or, (padded[a : a + rows] for a in range(width)))
    pooled: Bytes = functools.reduce(np.bitwise_or, (tall[:, a : a + cols] for a in range(width)))
    return pooled


@compiled
def window_layers(
    pooled: Bytes, part: Part, corner: Array, resolution: float, pose: Array, size: tuple[int, float], path: Array
) -> Bytes:
    """(8,n,n) 255 where a layer is set around `pose`: the first row lies ahead of the robot, the first column left.

    `pooled` is the `part` of the grid of pooled codes that the window can show: its first row and column, and how many
    the whole has; `corner` (2,) is the lower left corner of the whole. `size` holds n and the side of a window cell in
    metres, `path` (m,2) the points of the layer "path". Outside the grid everything is unknown.
    """
    n, side = size
    top, start, rows, cols = part
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    c, s, half = cosine * side / resolution, sine * side / resolution, 0.5 * (n - 1)
    x = (pose[0] - corner[0]) / resolution + c * half - s * half  # the middle of the first cell, ahead on the left
    y = (pose[1] - corner[1]) / resolution + s * half + c * half
    window, flat, wide = np.full((n, n), UNKNOWN, np.uint8), pooled.reshape(-1), np.int32(pooled.shape[1])
    skipped, place = np.int32(top * pooled.shape[1] + start), np.empty(n, np.int32)
    down, right = c * np.arange(n), s * np.arange(n)
    for i in range(n):
        u, v, first, last = x - c * i, y - s * i, 0, n  # a row of the window enters the grid once, and leaves it once
        while first < n and not ((0.0 <= u + s * first < cols) & (0.0 <= v - c * first < rows)):
            first += 1
        while last > first and not ((0.0 <= u + s * (last - 1) < cols) & (0.0 <= v - c * (last - 1) < rows)):
            last -= 1
        at, row, below, beside = place[first:last], window[i, first:last], down[first:last], right[first:last]
        for j in range(at.shape[0]):  # several at a time; then those of one row after the other
            at[j] = np.int32(v - below[j]) * wide + np.int32(u + beside[j]) - skipped
        for j in range(at.shape[0]):
            row[j] = flat[np.uint32(at[j])]
    for k in range(path.shape[0]):
        dx, dy = path[k, 0] - pose[0], path[k, 1] - pose[1]
        i = math.floor(0.5 * n - (cosine * dx + sine * dy) / side)
        j = math.floor(0.5 * n - (-sine * dx + cosine * dy) / side)
        if i >= 0 and j >= 0 and i < n and j < n:
            window[i, j] |= PATH
    layers, codes = np.empty((8, n * n), np.uint8), window.reshape(-1)
    for layer in range(8):
        bit = np.uint8(1 << layer)
        for k in range(n * n):
            layers[layer, k] = np.uint8(255) if codes[k] & bit else np.uint8(0)
    return layers.reshape(8, n, n)


@compiled
def fill_tables(
    tables: tuple[Floats, Floats, Floats, Floats],
    belief: tuple[Array, Array, Array, Array],
    labels: tuple[Ints, Ints, Ints, Ints],
    p_goals: Array,
    limits: Floats,
) -> int:
    """Write `pose` (4,), `pose_cov` (6,), `landmarks` (R,8) and the places in `goals` (G,k); how many values were cut.

    `belief`: pose (3,), its covariance (3,3), landmarks (N,2) and their covariances (N,2,2). `labels`: ids (N,) of the
    landmarks, room and kind (F,) by id, and what each room became (M,). `p_goals` (g,2) m, map frame. `limits`
    (2,18+k): lower and upper bounds of the columns of the four tables.
    """
    pose, pose_cov, landmarks, goals = tables
    T_map_robot, cov, p_map, covs = belief
    pose[0], pose[1] = T_map_robot[0], T_map_robot[1]
    pose[2], pose[3] = math.cos(T_map_robot[2]), math.sin(T_map_robot[2])
    k = 0
    for i in range(3):
        for j in range(i, 3):
            pose_cov[k] = cov[i, j]
            k += 1
    landmark_rows(T_map_robot, p_map, covs, labels, landmarks)
    c, s = math.cos(T_map_robot[2]), math.sin(T_map_robot[2])
    for k in range(min(p_goals.shape[0], goals.shape[0])):
        dx, dy = p_goals[k, 0] - T_map_robot[0], p_goals[k, 1] - T_map_robot[1]
        goals[k, 0] = c * dx + s * dy
        goals[k, 1] = -s * dx + c * dy
    cut = saturate(pose.reshape(1, 4), limits, 0) + saturate(pose_cov.reshape(1, 6), limits, 4)
    return cut + saturate(landmarks, limits, 10) + saturate(goals, limits, 18)


@compiled
def landmark_rows(pose: Array, p_map: Array, covs: Array, labels: tuple[Ints, Ints, Ints, Ints], rows: Floats) -> None:
    """Fill `rows` (R,8), the nearest first: x, y, cov xx, xy, yy in robot axes, room, kind, valid."""
    ids, room, kind, became = labels
    count = min(p_map.shape[0], rows.shape[0])
    order, far = np.empty(count, np.int64), np.empty(count)  # sorted by insertion: equally near ones keep their order
    for i in range(p_map.shape[0]):
        dx, dy = p_map[i, 0] - pose[0], p_map[i, 1] - pose[1]
        square, at = dx * dx + dy * dy, min(i, count - 1)
        if i >= count and square >= far[at]:  # the last of the nearest goes, or this one
            continue
        while at > 0 and far[at - 1] > square:
            far[at], order[at] = far[at - 1], order[at - 1]
            at -= 1
        far[at], order[at] = square, i
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for k in range(count):
        i = order[k]
        dx, dy = p_map[i, 0] - pose[0], p_map[i, 1] - pose[1]
        xx, xy, yy = covs[i, 0, 0], covs[i, 0, 1], covs[i, 1, 1]
        rows[k, 0] = c * dx + s * dy
        rows[k, 1] = -s * dx + c * dy
        rows[k, 2] = c * c * xx + 2.0 * c * s * xy + s * s * yy
        rows[k, 3] = c * s * (yy - xx) + (c * c - s * s) * xy
        rows[k, 4] = s * s * xx - 2.0 * c * s * xy + c * c * yy
        own = room[ids[i]]
        rows[k, 5] = became[own] if 0 <= own < became.shape[0] else own
        rows[k, 6] = kind[ids[i]]
        rows[k, 7] = 1.0


@compiled
def saturate(rows: Floats, limits: Floats, first: int) -> int:
    """Bring `rows` (n,k) within `limits` in place (nan becomes 0); how many values were outside.

    `limits` (2,m): the lower and upper bound of column j stand in column first + j.
    """
    outside = 0
    for i in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            low, high = limits[0, first + j], limits[1, first + j]
            value = rows[i, j]
            if math.isnan(value):
                rows[i, j] = 0.0
                outside += 1
            elif value < low or value > high:
                rows[i, j] = low if value < low else high
                outside += 1
    return outside
