"""Breadth-first levels: of the polygons of a room from where it was entered, of the rooms from the first one."""

from __future__ import annotations

import math

from mecp_env.core.array_types import Array
from mecp_env.slam.messages import UNKNOWN_ROOM, RoomGraph, SlamOutput

Point = tuple[float, float]


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


def polygon_levels(output: SlamOutput, room: int, p_entry: Array | None) -> tuple[list[Point], list[int]]:
    """Centres (m, map frame) and levels of the known polygons of a room; neighbours share a vertex.

    Level 0 is the polygon nearest to where the room was entered.
    """
    rings = rings_of_room(output, room)
    if not rings:
        return [], []
    p_map = output.belief.p_map.tolist()
    centres = [centre_of([p_map[row] for row in sorted(ring)]) for ring in rings]
    x, y = centres[0] if p_entry is None else p_entry.tolist()
    far = [math.hypot(a - x, b - y) for a, b in centres]
    level = levels_from(far.index(min(far)), neighbours_of(rings))
    return centres, [level.get(i, len(rings)) for i in range(len(rings))]


def centre_of(points: list[list[float]]) -> Point:
    """The mean of some points."""
    x, y = points[0]
    for a, b in points[1:]:
        x, y = x + a, y + b
    return x / len(points), y / len(points)


def neighbours_of(rings: list[list[int]]) -> dict[int, set[int]]:
    """The rings that share a vertex with each ring."""
    owners: dict[int, set[int]] = {}
    for i, ring in enumerate(rings):
        for row in ring:
            owners.setdefault(row, set()).add(i)
    return {i: set().union(*(owners[row] for row in ring)) for i, ring in enumerate(rings)}


def rings_of_room(output: SlamOutput, room: int) -> list[list[int]]:
    """Of the known polygons of a room: the rows of their vertices in the belief, where all are landmarks."""
    row = {landmark: i for i, landmark in enumerate(output.belief.ids.tolist())}
    rings = [p.ids.tolist() for p in output.map_polygons if output.graph.resolve(p.room) == room]
    return [[row[i] for i in ids] for ids in rings if row.keys() >= set(ids)]
