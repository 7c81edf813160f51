"""Breadth-first levels: of the polygons of a room from where it was entered, of the rooms from the first one."""

from __future__ import annotations

import math
from itertools import accumulate

import numpy as np

from mecp_env.core.arrays import rows_by_id
from mecp_env.core.carriers import Array, Ints
from mecp_env.core.jit import compiled
from mecp_env.slam.messages import UNKNOWN_ROOM, Belief, RoomGraph
from mecp_env.slam.output import SlamOutput


def levels_from(start: int, neighbours: dict[int, set[int]]) -> dict[int, int]:
    """Number of steps from `start` to every node that can be reached."""
    level, wave = {start: 0}, [start]
    while wave:
        onward = sorted({other for node in wave for other in neighbours.get(node, set())} - level.keys())
        level |= dict.fromkeys(onward, level[wave[0]] + 1)
        wave = onward
    return level


def door_levels(graph: RoomGraph, first_room: int) -> dict[int, int]:
    """Level of each room: how many doors lie between it and the first room."""
    neighbours: dict[int, set[int]] = {}
    for door in graph.doors:
        a, b = (UNKNOWN_ROOM if room == UNKNOWN_ROOM else graph.resolve(room) for room in door.rooms)
        if UNKNOWN_ROOM not in (a, b):
            neighbours.setdefault(a, set()).add(b)
            neighbours.setdefault(b, set()).add(a)
    return levels_from(graph.resolve(first_room), neighbours)


def polygon_levels(rings: list[Ints], belief: Belief, p_entry: Array | None) -> tuple[Array, Ints]:
    """Centres (p,2) (m, map frame) and levels (p,) of the polygons of a room, `rings` of vertex ids.

    Neighbours share a vertex. Level 0 is the polygon nearest to where the room was entered; polygons out of reach have
    the number of all as their level. A polygon with a vertex that is no landmark is left out.
    """
    ids = np.concatenate([np.empty(0, np.int64), *rings])
    rows, first = rows_by_id(belief.ids, ids)[ids], np.array([0, *accumulate(map(len, rings))], np.int64)
    entry = np.full(2, math.nan) if p_entry is None else p_entry
    return _ring_levels(rows, first, belief.p_map, entry)


@compiled
def _ring_levels(rows: Ints, first: Ints, p_map: Array, p_entry: Array) -> tuple[Array, Ints]:
    """See `polygon_levels`: ring p has the landmarks `rows` from first[p] on, -1: none; nan: entered at the first."""
    centres, ring = np.empty((first.shape[0] - 1, 2)), np.empty(first.shape[0] - 1, np.int64)
    count, start, best = 0, 0, math.inf
    for p in range(ring.shape[0]):
        own = np.sort(rows[first[p] : first[p + 1]])
        if own[0] < 0:
            continue
        x, y = 0.0, 0.0
        for row in own:
            x, y = x + p_map[row, 0], y + p_map[row, 1]
        centres[count, 0], centres[count, 1], ring[count] = x / own.shape[0], y / own.shape[0], p
        at = p_entry if p_entry[0] == p_entry[0] else centres[0]
        far = math.hypot(centres[count, 0] - at[0], centres[count, 1] - at[1])
        if far < best:
            start, best = count, far
        count += 1
    level, reached = np.full(count, count, np.int64), np.zeros(p_map.shape[0], np.bool_)
    level[start : start + 1] = 0
    wave, last = 0, 0
    while wave <= last:
        for k in range(count):
            for i in range(first[ring[k]], first[ring[k] + 1] if level[k] == wave else first[ring[k]]):
                reached[rows[i]] = True
        for k in range(count):
            for i in range(first[ring[k]], first[ring[k] + 1] if level[k] == count else first[ring[k]]):
                level[k], last = (wave + 1, wave + 1) if reached[rows[i]] else (level[k], last)
        wave += 1
    return centres[:count], level


def rings_by_room(output: SlamOutput, rooms: set[int]) -> dict[int, list[Ints]]:
    """The vertex ids of the known polygons of each room."""
    became = {room: output.graph.resolve(room) for room in {polygon.room for polygon in output.map_polygons}}
    rings: dict[int, list[Ints]] = {room: [] for room in rooms}
    for polygon in output.map_polygons:
        if became[polygon.room] in rooms:
            rings[became[polygon.room]].append(polygon.ids)
    return rings
