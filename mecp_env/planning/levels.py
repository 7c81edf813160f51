"""Breadth-first levels: of the polygons of a room from where it was entered, of the rooms from the first one."""

from __future__ import annotations

import math

from mecp_env.core.array_types import Array
from mecp_env.slam.messages import NO_ID, UNKNOWN_ROOM, RoomGraph, SlamOutput

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


def polygon_levels(
    rings: list[list[int]], p_map: list[list[float]], p_entry: Array | None
) -> tuple[list[Point], list[int]]:
    """Centres (m, map frame) and levels of the polygons of a room, `rings` of rows of `p_map`.

    Neighbours share a vertex. Level 0 is the polygon nearest to where the room was entered.
    """
    if not rings:
        return [], []
    centres = [centre_of([p_map[row] for row in sorted(ring)]) for ring in rings]
    x, y = centres[0] if p_entry is None else p_entry.tolist()
    far = [math.hypot(a - x, b - y) for a, b in centres]
    return centres, ring_levels(far.index(min(far)), rings)


def centre_of(points: list[list[float]]) -> Point:
    """The mean of some points."""
    x, y = points[0]
    for a, b in points[1:]:
        x, y = x + a, y + b
    return x / len(points), y / len(points)


def ring_levels(start: int, rings: list[list[int]]) -> list[int]:
    """Number of steps from the ring `start` to each, over shared vertices; of those out of reach how many there are."""
    owners: dict[int, list[int]] = {}
    for i, ring in enumerate(rings):
        for row in ring:
            owners.setdefault(row, []).append(i)
    level, wave = {start: 0}, {start}
    while wave:
        onward = {i for ring in wave for row in rings[ring] for i in owners.pop(row, ())} - level.keys()
        level |= dict.fromkeys(onward, level[next(iter(wave))] + 1)
        wave = onward
    return [level.get(i, len(rings)) for i in range(len(rings))]


def rings_by_room(output: SlamOutput, rooms: set[int]) -> dict[int, list[list[int]]]:
    """Of the known polygons of each room: the rows of their vertices in the belief, where all are landmarks."""
    ids = output.belief.ids.tolist()
    row = dict(zip(ids, range(len(ids)), strict=True))
    named = [polygon.room for polygon in output.map_polygons]
    became = {room: output.graph.resolve(room) for room in set(named)}
    rings: dict[int, list[list[int]]] = {room: [] for room in rooms}
    for polygon, name in zip(output.map_polygons, named, strict=True):
        vertices = [row.get(vertex, NO_ID) for vertex in polygon.ids.tolist()] if became[name] in rooms else [NO_ID]
        if NO_ID not in vertices:
            rings[became[name]].append(vertices)
    return rings
