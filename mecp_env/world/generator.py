"""Generated buildings: a specification and a seed give a layout with known rooms and doors.

`generate(spec, seed)` divides a rectangle among the rooms, finds the walls between them, opens doors along a spanning
tree and one more per loop (`partition`), and places furniture (`furniture`).
"""

from __future__ import annotations

import math
from collections import Counter
from itertools import count, islice
from typing import Any

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.errors import ConfigError, LayoutError
from mecp_env.core.settings import shown
from mecp_env.world.config import GeneratorSpec, Rejected
from mecp_env.world.furniture import Room, edge_distances, furnish, inside
from mecp_env.world.partition import (
    Line,
    Opening,
    Point,
    Space,
    borders,
    joined,
    partition,
    plan_doors,
    shared_stretches,
    wall_lines,
)
from mecp_env.world.schema import Layout

__all__ = ["GeneratorSpec", "generate"]

ATTEMPTS = 100  # rejected buildings before a specification counts as impossible,
FURNISHED = 10  # and rejections for too little furniture
START_CLEAR_M = 0.45  # between a start and every wall and piece
MOST_STARTS = 4
START_TRIES = 20  # to find one in a room
MOST_SEED = 2**128 - 1  # as many bits as NumPy's own seeds have


def generate(spec: GeneratorSpec | dict[str, Any] | None = None, seed: int = 0) -> Layout:
    """The building of a seed: rooms, corridors, doors, slanted corners and furniture as the specification declares.

    The same specification and seed give the same layout. Every room and door is in reach of a robot of 0.22 m; no two
    corners of a room but the posts of a door are nearer to each other than 0.25 m. Raises `ConfigError` for a wrong
    field or seed, and for a specification that no building fulfils.
    """
    spec = GeneratorSpec.parse(spec)
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or not 0 <= seed <= MOST_SEED:
        raise ConfigError(f"seed: a whole number from 0 to 2**128 - 1 expected (given: {shown(seed)})")
    spec.require_doors()
    rng = np.random.default_rng(seed)
    rejected: list[Rejected] = []
    while len(rejected) < ATTEMPTS and sum(why.field == "furniture" for why in rejected) < FURNISHED:
        try:
            return _attempt(spec, int(seed), rng)
        except Rejected as why:
            rejected.append(why)
        except LayoutError as error:
            raise ConfigError(f"rooms, furniture: more than a layout may hold ({error})") from None
    raise ConfigError(_impossible(spec, rejected))


def _impossible(spec: GeneratorSpec, rejected: list[Rejected]) -> str:
    """The error for a specification: the field that failed most often or last, its value, the largest value found."""
    counts = Counter(why.field for why in rejected)
    field = "furniture" if counts["furniture"] >= FURNISHED else counts.most_common(1)[0][0]
    most = max(why.most for why in rejected if why.field == field)
    value, tried = getattr(spec, field), f"in {len(rejected)} tries at buildings of {spec.rooms} rooms"
    say = {
        "rooms": "rooms with these corridors and shapes, none fitted together",
        "loops": f"loops, at most {most:.0f} came about",
        "slanted_corners": f"slanted corners, at most {most:.0f} came about",
        "furniture": f"pieces on 10 m2, at most {most:.2f} found room (0.8 m clear of each other and of walls)",
    }
    return f"{field}: {value:g} {say[field]} {tried}; ask for less, or for larger rooms"


def _attempt(spec: GeneratorSpec, seed: int, rng: np.random.Generator) -> Layout:
    """One try. Raises `Rejected` when rooms do not fit into the plot, doors not between them, or furniture not in."""
    spaces = partition(spec, rng)
    low, high = spec.wall_thickness_m
    thickness = min(max(round(float(rng.uniform(low, high)), 3), low), high)  # whole millimetres, if the range has one
    slants = _cut_corners(spaces, spec, rng)
    if len(slants) < spec.slanted_corners:
        raise Rejected("slanted_corners", len(slants))
    lines = borders(spaces)
    doors = plan_doors(spaces, shared_stretches(lines), thickness, spec, rng)
    furnished = furnish(spaces, doors, thickness, spec, rng)
    starts = _starts(spaces, furnished, rng)
    if not starts:
        raise Rejected("furniture")
    turned, names = _Turned(math.radians(rng.uniform(*spec.turned_deg))), _names(spaces)
    return Layout(
        name=f"rooms-{spec.rooms}-{seed}",
        walls=[{"points": turned.line(w), "thickness_m": thickness} for w in joined(wall_lines(lines), slants)],
        rooms=[{"name": n, "polygon": turned.line(s.ring)} for n, s in zip(names, spaces, strict=True)],
        doors=[turned.door(door, names) for door in doors],
        obstacles=turned.furniture(furnished),
        starts=[{"point": turned.point(p), "heading_deg": turned.heading(heading)} for p, heading in starts],
    )


def _cut_corners(spaces: list[Space], spec: GeneratorSpec, rng: np.random.Generator) -> list[tuple[Point, Point]]:
    """Cut outer corners of the building off, in place; the ends of each slanted wall, counter-clockwise."""
    points = [p for space in spaces for p in space.ring]
    (x0, y0), (x1, y1) = np.min(points, axis=0).tolist(), np.max(points, axis=0).tolist()
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    plain = {p: space.ring for space in spaces for p in space.ring if len(space.ring) == 4 and not space.corridor}
    there = [corners[i] for i in rng.permutation(4).tolist() if corners[i] in plain]
    return [_cut(plain[corner], corner, rng) for corner in there[: spec.slanted_corners]]


def _cut(ring: list[Point], corner: Point, rng: np.random.Generator) -> tuple[Point, Point]:
    """Replace a corner of a ring by two points on its edges, in place; the two."""
    place, (x, y) = ring.index(corner), corner
    shares = rng.uniform(0.25, 0.4, 2).tolist()
    ends = [
        (round(x + share * (px - x), 3), round(y + share * (py - y), 3))
        for share, (px, py) in zip(shares, (ring[place - 1], ring[(place + 1) % len(ring)]), strict=True)
    ]
    ring[place : place + 1] = ends
    return ends[0], ends[1]


def _starts(spaces: list[Space], rooms: list[Room], rng: np.random.Generator) -> list[tuple[Point, float]]:
    """A start in each of a few rooms in random order: point and heading in degrees."""
    circles = np.concatenate([room.circles for room in rooms])
    order = rng.permutation(len(spaces)).tolist()
    points = (_free_point(np.array(spaces[index].ring), circles, rng) for index in order)
    found = [point for point in islice(points, 2 * MOST_STARTS) if point is not None]
    return [(point, float(rng.integers(-180, 180))) for point in found[:MOST_STARTS]]


def _free_point(ring: Array, circles: Array, rng: np.random.Generator) -> Point | None:
    """A point of a room, clear of its walls and of the circles (c,3) around all furniture."""
    points = rng.uniform(ring.min(axis=0), ring.max(axis=0), (START_TRIES, 2))
    off = np.hypot(points[:, :1] - circles[:, 0], points[:, 1:] - circles[:, 1]) - circles[:, 2]
    clear = inside(ring, points) & (edge_distances(ring, points).min(axis=1) > START_CLEAR_M + 0.1)
    found = np.flatnonzero(clear & (off.min(axis=1, initial=np.inf) > START_CLEAR_M))
    return (float(points[found[0], 0]), float(points[found[0], 1])) if len(found) else None


class _Turned:
    """Turns a plan about its origin, and writes its parts as a layout has them."""

    def __init__(self, angle: float) -> None:
        self.cos, self.sin, self.degrees = math.cos(angle), math.sin(angle), math.degrees(angle)

    def point(self, p: Point) -> Point:
        return self.cos * p[0] - self.sin * p[1], self.sin * p[0] + self.cos * p[1]

    def line(self, points: Line) -> list[Point]:
        return [self.point(p) for p in points]

    def heading(self, degrees: float) -> float:
        return (degrees + self.degrees + 180.0) % 360.0 - 180.0

    def door(self, door: Opening, names: list[str]) -> dict[str, Any]:
        rooms, heading = (names[door.rooms[0]], names[door.rooms[1]]), self.heading(math.degrees(door.heading))
        return {"centre": self.point(door.centre), "width_m": door.width, "rooms": rooms, "direction_deg": heading}

    def furniture(self, rooms: list[Room]) -> list[dict[str, Any]]:
        return [self.piece(piece) for room in rooms for piece in room.pieces]

    def piece(self, piece: dict[str, Any]) -> dict[str, Any]:
        turn = {"turn_deg": self.heading(piece["turn_deg"])} if "turn_deg" in piece else {}
        return piece | {"centre": self.point(piece["centre"])} | turn


def _names(spaces: list[Space]) -> list[str]:
    """room 1, room 2, ..., corridor 1, ..."""
    rooms, corridors = count(1), count(1)
    return [f"corridor {next(corridors)}" if space.corridor else f"room {next(rooms)}" for space in spaces]
