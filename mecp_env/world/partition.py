"""Divides a rectangle among rooms: recursive splits, corridors between them, notches for L, T and U.

The walls between the rooms of a plan, as few and as long as can be, and where two rooms share one.

Doors: one for each edge of a spanning tree of the rooms, and one more for each loop.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from itertools import islice, pairwise, product
from typing import NamedTuple

import numpy as np

from mecp_env.world.config import ROOMS_OF, GeneratorSpec, Rejected

GRID_M = 0.05  # walls lie on multiples of this
CUTS = 20  # candidate cuts of one rectangle
ATTEMPTS = 3  # of them are followed before the rectangle around it is cut again
CORRIDOR_M = 1.8  # wide, for a first guess of the plot
LONGEST = 3.0  # times as long as wide a room may be
NARROWEST_M = 2.6  # of a room
NOTCH_M, ARM_M = 2.4, 1.9  # least side of a room in a notch, and of what is left beside it

Point = tuple[float, float]


class Rect(NamedTuple):
    """A rectangle along the axes."""

    x0: float
    y0: float
    x1: float
    y1: float

    @property
    def size(self) -> tuple[float, float]:
        """Width and height, m."""
        return self.x1 - self.x0, self.y1 - self.y0

    def ring(self) -> list[Point]:
        """Its corners, counter-clockwise."""
        return [(self.x0, self.y0), (self.x1, self.y0), (self.x1, self.y1), (self.x0, self.y1)]


class Item(NamedTuple):
    """One rectangle of the plan: a room, a shaped room with those in its notches, or a yard."""

    shape: str
    area: float  # m^2


@dataclass(frozen=True, slots=True)
class Space:
    """A room of the plan."""

    ring: list[Point]  # counter-clockwise, up to the middle of the walls
    corridor: bool = False


def partition(spec: GeneratorSpec, rng: np.random.Generator) -> list[Space]:
    """The rooms of a building on a rectangular plot, corridors among them. Raises `Rejected` when they did not fit."""
    items = _items(spec, rng)
    area = 1.05 * _area(items, spec.corridors)
    width = math.sqrt(area * rng.uniform(0.8, 1.8))
    plot = Rect(0.0, 0.0, _snap(width), _snap(area / width))
    spaces = _fill(plot, items, spec.corridors, spec, rng)
    if spaces is None:
        raise Rejected("rooms")
    return spaces


def _area(items: list[Item], corridors: int) -> float:
    """Area that the items need, with so many corridors as long as a square of them is wide, m^2."""
    rooms = sum(item.area for item in items)
    return rooms + corridors * CORRIDOR_M * math.sqrt(rooms / (corridors + 1))


def _items(spec: GeneratorSpec, rng: np.random.Generator) -> list[Item]:
    """All items with their areas, in random order."""
    shapes = [str(shape) for shape in rng.choice(spec.shapes, spec.shaped_rooms)]
    plain = spec.rooms - spec.corridors - sum(ROOMS_OF[shape] for shape in shapes)
    shapes += ["rectangle"] * plain + ["yard"] * spec.yards
    sides = rng.uniform(*spec.room_side_m, len(shapes)).tolist()
    roomy = {"rectangle": 1.0, "yard": 1.0, "L": 1.7, "U": 2.0, "T": 2.4}
    items = [
        Item(shape, max(side * side * roomy[shape], _least_area(shape)))
        for shape, side in zip(shapes, sides, strict=True)
    ]
    rank = [item.area * share for item, share in zip(items, rng.uniform(0.5, 2.0, len(items)).tolist(), strict=True)]
    return [items[i] for i in np.argsort(rank).tolist()]  # large ones rather beside large ones, or nothing fits


def _least_area(shape: str) -> float:
    width, height = _least_sides(shape)
    return 1.25 * width * height


def _least_sides(shape: str) -> tuple[float, float]:
    """Length and breadth that a shape needs at least."""
    deep = NOTCH_M + ARM_M
    sides = {"L": (deep, deep), "U": (2 * ARM_M + NOTCH_M, deep), "T": (2 * NOTCH_M + ARM_M, deep)}
    return sides.get(shape, (NARROWEST_M, NARROWEST_M))


def _fill(
    rect: Rect, items: list[Item], corridors: int, spec: GeneratorSpec, rng: np.random.Generator
) -> list[Space] | None:
    """`rect` divided among `items` and so many corridors; None when it cannot be."""
    if len(items) == 1:
        return _leaf(rect, items[0], rng)
    cuts = (_divide(rect, items, corridors, spec, rng) for _ in range(CUTS))
    likely = (cut for cut in cuts if _plausible(*cut[1][0]) and _plausible(*cut[1][1]))
    for corridor, parts in islice(likely, ATTEMPTS):
        spaces = _fill_both(parts, spec, rng)
        if spaces is not None:
            return corridor + spaces
    return None


def _fill_both(
    parts: list[tuple[Rect, list[Item], int]], spec: GeneratorSpec, rng: np.random.Generator
) -> list[Space] | None:
    """The rooms of two parts, or None when one of them cannot be divided."""
    first = _fill(*parts[0], spec, rng)
    second = None if first is None else _fill(*parts[1], spec, rng)
    return None if first is None or second is None else first + second


def _plausible(rect: Rect, items: list[Item], corridors: int) -> bool:
    """False where `items` and corridors certainly do not fit into `rect`."""
    long, short = max(rect.size), min(rect.size)
    if len(items) == 1:
        least = _least_sides(items[0].shape)
        return corridors == 0 and long >= least[0] and short >= least[1] and long <= LONGEST * short
    breadth = max(_least_sides(item.shape)[1] for item in items)
    return short >= breadth and long <= 2.0 * LONGEST * short and len(items) > 2 * corridors


def _divide(
    rect: Rect, items: list[Item], corridors: int, spec: GeneratorSpec, rng: np.random.Generator
) -> tuple[list[Space], list[tuple[Rect, list[Item], int]]]:
    """`rect` cut in two across its longer side, with a corridor along it in between where there shall be one."""
    strip = _snap(rng.uniform(*spec.corridor_width_m)) if corridors else 0.0
    cut = max(1, min(len(items) - 1, round(len(items) * rng.uniform(0.3, 0.7))))
    first, second = items[:cut], items[cut:]
    corridors -= bool(strip)
    here = round(corridors * len(first) / len(items))
    one, two = _area(first, here), _area(second, corridors - here)
    wide = rect.x1 - rect.x0 > rect.y1 - rect.y0
    lengthwise = (wide != bool(strip)) == (rng.random() < 0.8)
    low, high = (rect.x0, rect.x1) if lengthwise else (rect.y0, rect.y1)
    at = _snap(low + (high - low - strip) * one / (one + two))
    corridor = [Space(_slice(rect, lengthwise, at, _snap(at + strip)).ring(), True)] if strip else []
    below, above = _slice(rect, lengthwise, low, at), _slice(rect, lengthwise, _snap(at + strip), high)
    return corridor, [(below, first, here), (above, second, corridors - here)]


def _slice(rect: Rect, lengthwise: bool, low: float, high: float) -> Rect:
    """The part of `rect` between two values of x (lengthwise) or y."""
    return rect._replace(x0=low, x1=high) if lengthwise else rect._replace(y0=low, y1=high)


def _leaf(rect: Rect, item: Item, rng: np.random.Generator) -> list[Space] | None:
    """The rooms of one item in its rectangle, or None when it is too narrow for them."""
    width, height = rect.size
    upright = height > width
    length, breadth = (height, width) if upright else (width, height)
    least = _least_sides(item.shape)
    if length < least[0] or breadth < least[1] or length > LONGEST * breadth:
        return None
    rings = _shaped(item.shape, length, breadth, rng)
    mirror = (bool(rng.integers(2)), bool(rng.integers(2)))
    return [Space(_place(ring, rect, upright, mirror)) for ring in rings]


def _shaped(shape: str, length: float, breadth: float, rng: np.random.Generator) -> list[list[Point]]:
    """Rings of the rooms of a shape in a rectangle (0, 0) to (length, breadth): itself, then those in its notches."""
    if shape == "yard":
        return []
    if shape == "rectangle":
        return [Rect(0.0, 0.0, length, breadth).ring()]
    deep = _between(rng, NOTCH_M, breadth - ARM_M)  # of the notches, from above
    y = _snap(breadth - deep)
    if shape == "L":
        x = _snap(length - _between(rng, NOTCH_M, length - ARM_M))
        room = [(0.0, 0.0), (length, 0.0), (length, y), (x, y), (x, breadth), (0.0, breadth)]
        return [room, Rect(x, y, length, breadth).ring()]
    slack = length - (2 * ARM_M + NOTCH_M if shape == "U" else 2 * NOTCH_M + ARM_M)
    a = _snap((ARM_M if shape == "U" else NOTCH_M) + slack * rng.uniform(0.2, 0.5))
    b = _snap(length - (ARM_M if shape == "U" else NOTCH_M) - slack * rng.uniform(0.0, 0.3))
    if shape == "U":
        room = [
            (0.0, 0.0),
            (length, 0.0),
            (length, breadth),
            (b, breadth),
            (b, y),
            (a, y),
            (a, breadth),
            (0.0, breadth),
        ]
        return [room, Rect(a, y, b, breadth).ring()]
    room = [(0.0, 0.0), (length, 0.0), (length, y), (b, y), (b, breadth), (a, breadth), (a, y), (0.0, y)]
    return [room, Rect(0.0, y, a, breadth).ring(), Rect(b, y, length, breadth).ring()]


def _place(ring: list[Point], rect: Rect, upright: bool, mirror: tuple[bool, bool]) -> list[Point]:
    """`ring` moved into `rect`: turned upright, mirrored in x and y; counter-clockwise again."""
    width, height = rect.size
    points = [(y, x) if upright else (x, y) for x, y in ring]
    points = [(width - x if mirror[0] else x, height - y if mirror[1] else y) for x, y in points]
    points = [(_snap(rect.x0 + x), _snap(rect.y0 + y)) for x, y in points]
    return points[::-1] if (upright + mirror[0] + mirror[1]) % 2 else points


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low, max(low, high)))


def _snap(value: float) -> float:
    """The multiple of the grid next to a length."""
    return round(round(value / GRID_M) * GRID_M, 6)


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


ANY = 1000  # doors of a corridor
POST_M = 0.35  # of straight wall beside a door, at least


class Opening(NamedTuple):
    """A door of the plan."""

    centre: Point
    width: float  # m
    rooms: tuple[int, int]
    heading: float  # rad, heading from the first room to the second


def plan_doors(
    spaces: list[Space], stretches: list[Shared], thickness: float, spec: GeneratorSpec, rng: np.random.Generator
) -> list[Opening]:
    """rooms - 1 + loops doors that join all rooms, no two between the same rooms. Raises `Rejected`."""
    widths = rng.uniform(*spec.door_width_m, spec.rooms - 1 + spec.loops)
    places = _places(stretches, float(widths.max()) + 2.0 * POST_M + thickness)
    pairs = _chosen(list(places), spaces, spec, rng)
    return [_opening(places[pair], float(width), thickness, rng) for pair, width in zip(pairs, widths, strict=True)]


def _places(stretches: list[Shared], least: float) -> dict[tuple[int, int], Shared]:
    """The longest stretch of wall between each two rooms, where a door fits into it."""
    places: dict[tuple[int, int], Shared] = {}
    for stretch in stretches:
        length, pair = stretch.high - stretch.low, (min(stretch.rooms), max(stretch.rooms))
        if length >= least and (pair not in places or length > places[pair].high - places[pair].low):
            places[pair] = stretch
    return places


def _chosen(
    pairs: list[tuple[int, int]], spaces: list[Space], spec: GeneratorSpec, rng: np.random.Generator
) -> list[tuple[int, int]]:
    """Pairs of rooms with a door: first a tree in random order that prefers corridors, then the loops."""
    corridor = np.array([space.corridor for space in spaces])
    order = rng.random(len(pairs)) - 0.5 * corridor[np.array(pairs, np.int64).reshape(-1, 2)].sum(axis=1)
    ranked = [pairs[i] for i in np.argsort(order, kind="stable").tolist()]
    most = np.where(corridor, ANY, spec.max_doors).tolist()
    tree = _tree(ranked, most)
    loops = [pair for pair in ranked if pair not in tree and _take(pair, most)]
    if len(tree) < spec.rooms - 1:
        raise Rejected("rooms")
    if len(loops) < spec.loops:
        raise Rejected("loops", len(loops))
    return tree + loops[: spec.loops]


def _tree(ranked: list[tuple[int, int]], most: list[int]) -> list[tuple[int, int]]:
    """The first pairs that join all rooms; `most` is what is left of the doors that each room may have, in place."""
    group = list(range(len(most)))
    tree = []
    for a, b in ranked:
        if group[a] != group[b] and _take((a, b), most):
            tree.append((a, b))
            group = [group[a] if g == group[b] else g for g in group]
    return tree


def _take(pair: tuple[int, int], most: list[int]) -> bool:
    """Use up one door of either room, in place; False where one of them may have no more."""
    a, b = pair
    if min(most[a], most[b]) < 1:
        return False
    most[a], most[b] = most[a] - 1, most[b] - 1
    return True


def _opening(stretch: Shared, width: float, thickness: float, rng: np.random.Generator) -> Opening:
    """A door anywhere in a part of wall that leaves a jamb on both sides."""
    margin = width / 2.0 + POST_M + thickness / 2.0
    along = float(rng.uniform(stretch.low + margin, stretch.high - margin))
    centre = (stretch.at, along) if stretch.vertical else (along, stretch.at)
    return Opening(centre, width, stretch.rooms, 0.0 if stretch.vertical else math.pi / 2.0)
