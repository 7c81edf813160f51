"""The walls between the rooms of a plan, as few and as long as can be, and where two rooms share one."""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise, product
from typing import NamedTuple

from mecp_env.world.generator.partition import Point, Space

Line = list[Point]


class Border(NamedTuple):
    """One edge of a room that lies along an axis."""

    vertical: bool
    at: float  # x of a vertical edge, y of another one
    low: float
    high: float
    room: int
    side: int  # 1: the room lies at larger x (or y), -1: at smaller


class Shared(NamedTuple):
    """A straight stretch of wall with one room on either side."""

    vertical: bool
    at: float
    low: float
    high: float
    rooms: tuple[int, int]  # at smaller x (or y), at larger


def borders(spaces: list[Space]) -> dict[tuple[bool, float], list[Border]]:
    """The axis-parallel edges of all rooms, by the line that they lie on."""
    lines: dict[tuple[bool, float], list[Border]] = defaultdict(list)
    edges = ((a, b, room) for room, space in enumerate(spaces) for a, b in pairwise([*space.ring, space.ring[0]]))
    for edge in (_border(a, b, room) for a, b, room in edges if a[0] == b[0] or a[1] == b[1]):
        lines[edge.vertical, edge.at].append(edge)
    return dict(sorted(lines.items()))


def _border(start: Point, end: Point, room: int) -> Border:
    """An edge of a room, which lies on its left."""
    vertical = start[0] == end[0]
    along, across = (1, 0) if vertical else (0, 1)
    forward = end[along] > start[along]
    low, high = sorted((start[along], end[along]))
    return Border(vertical, start[across], low, high, room, 1 if forward != vertical else -1)


def wall_lines(lines: dict[tuple[bool, float], list[Border]]) -> list[Line]:
    """The middle lines of the walls: edges on one line that touch are one wall."""
    walls: list[Line] = []
    for (vertical, at), edges in lines.items():
        stretches = _united(sorted((edge.low, edge.high) for edge in edges))
        walls += [[(at, low), (at, high)] if vertical else [(low, at), (high, at)] for low, high in stretches]
    return walls


def _united(intervals: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Intervals in order, those that touch as one."""
    united = intervals[:1]
    for low, high in intervals[1:]:
        if low <= united[-1][1]:
            united[-1] = (united[-1][0], max(united[-1][1], high))
        else:
            united.append((low, high))
    return united


def shared_stretches(lines: dict[tuple[bool, float], list[Border]]) -> list[Shared]:
    """Where an edge of one room lies against one of another."""
    pairs = ((a, b) for edges in lines.values() for a, b in product(edges, edges) if a.side < 0 < b.side)
    shared = (Shared(a.vertical, a.at, max(a.low, b.low), min(a.high, b.high), (a.room, b.room)) for a, b in pairs)
    return [stretch for stretch in shared if stretch.low < stretch.high]


def joined(walls: list[Line], slants: list[tuple[Point, Point]]) -> list[Line]:
    """The walls with each slant (two points, where walls end) between the two that it joins, as one line of many."""
    for start, end in slants:
        before = next(wall for wall in walls if start in (wall[0], wall[-1]))
        after = next(wall for wall in walls if end in (wall[0], wall[-1]))
        walls = [wall for wall in walls if wall is not before and wall is not after]
        before = before if before[-1] == start else before[::-1]
        after = after if after[0] == end else after[::-1]
        walls.append(before + after)
    return walls
