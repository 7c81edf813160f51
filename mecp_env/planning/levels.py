"""Breadth-first levels: of the polygons of a room from where it was entered, of the rooms from the first one."""

from __future__ import annotations

import numpy as np

from mecp_env.slam.data import UNKNOWN_ROOM, Array, Ints, RoomGraph, StepReport


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


def polygon_levels(report: StepReport, room: int, p_entry: Array | None) -> tuple[Array, Ints]:
    """Centres (p,2) m and levels (p,) of the known polygons of a room; neighbours share a vertex.

    Level 0 is the polygon nearest to where the room was entered.
    """
    rings = rings_of_room(report, room)
    if not rings:
        return np.empty((0, 2)), np.empty(0, np.int64)
    member = np.zeros((len(rings), len(report.belief.ids)))
    for i, rows in enumerate(rings):
        member[i, rows] = 1.0
    centres = (member[:, :, None] * report.belief.p_map).sum(axis=1) / member.sum(axis=1)[:, None]
    first = 0 if p_entry is None else int(np.hypot(*(centres - p_entry).T).argmin())
    together = np.asarray((member[:, None] * member[None]).sum(axis=2) > 0.0)
    level = levels_from(first, {i: set(np.flatnonzero(together[i]).tolist()) for i in range(len(rings))})
    return centres, np.array([level.get(i, len(rings)) for i in range(len(rings))], np.int64)


def rings_of_room(report: StepReport, room: int) -> list[list[int]]:
    """Of the known polygons of a room: the rows of their vertices in the belief, where all are landmarks."""
    row = {landmark: i for i, landmark in enumerate(report.belief.ids.tolist())}
    rings = [p.ids.tolist() for p in report.known_polygons if report.graph.resolve(p.room) == room]
    return [[row[i] for i in ids] for ids in rings if row.keys() >= set(ids)]
