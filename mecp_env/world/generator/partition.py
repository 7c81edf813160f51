"""Divides a rectangle among rooms: recursive splits, corridors between them, notches for L, T and U."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import numpy as np

from mecp_env.world.generator.spec import ROOMS_OF, GeneratorSpec, Rejected

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
