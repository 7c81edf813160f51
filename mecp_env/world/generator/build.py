"""From a specification and a seed to a layout."""

from __future__ import annotations

import math
from itertools import islice
from typing import Any

import numpy as np

from mecp_env.errors import ConfigError
from mecp_env.world.generator.doorplan import Opening, plan_doors
from mecp_env.world.generator.furniture import Placed, edge_distances, furnish, inside
from mecp_env.world.generator.partition import Point, Space, partition
from mecp_env.world.generator.spec import GeneratorSpec
from mecp_env.world.generator.walls import Line, borders, joined, shared_stretches, wall_lines
from mecp_env.world.schema import Layout

ATTEMPTS = 100  # buildings thrown away before a specification is called impossible
START_CLEAR_M = 0.45  # between a start and every wall and piece
MOST_STARTS = 4
START_TRIES = 20  # to find one in a room


def generate(spec: GeneratorSpec | dict[str, Any] | None = None, seed: int = 0) -> Layout:
    """The building of a seed: rooms, corridors, doors and furniture as the specification declares them.

    The same specification and seed give the same layout. Every room and door is in reach of a robot of 0.22 m; no two
    corners of a room but the posts of a door are nearer to each other than 0.25 m. Raises `ConfigError` for a wrong
    field, and for a specification that no building fulfils.
    """
    spec = GeneratorSpec.parse(spec)
    rng = np.random.default_rng(seed)
    for _ in range(ATTEMPTS):
        layout = _attempt(spec, seed, rng)
        if layout is not None:
            return layout
    raise ConfigError(
        f"no building of {spec.rooms} rooms with {spec.loops} loops found in {ATTEMPTS} attempts; ask for less"
    )


def _attempt(spec: GeneratorSpec, seed: int, rng: np.random.Generator) -> Layout | None:
    """One try: None when rooms do not fit into the plot, or doors not between the rooms."""
    spaces = partition(spec, rng)
    if spaces is None:
        return None
    thickness = round(float(rng.uniform(*spec.wall_thickness_m)), 3)
    slants = _cut_corners(spaces, spec, rng)
    lines = borders(spaces)
    doors = plan_doors(spaces, shared_stretches(lines), thickness, spec, rng)
    if doors is None:
        return None
    furniture = furnish(spaces, doors, thickness, spec, rng)
    starts = _starts(spaces, furniture, rng)
    if not starts:
        return None
    walls = joined(wall_lines(lines), slants)
    turn = math.radians(rng.uniform(*spec.turned_deg))
    return _layout(f"rooms-{spec.rooms}-{seed}", _Turned(turn), (spaces, walls, doors, furniture, starts), thickness)


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


def _starts(spaces: list[Space], furniture: list[Placed], rng: np.random.Generator) -> list[tuple[Point, float]]:
    """A start in each of a few rooms in random order: point and heading in degrees."""
    points = (_free_point(spaces[index].ring, furniture, rng) for index in rng.permutation(len(spaces)).tolist())
    found = [point for point in islice(points, 2 * MOST_STARTS) if point is not None]
    return [(point, float(rng.integers(-180, 180))) for point in found[:MOST_STARTS]]


def _free_point(ring: list[Point], furniture: list[Placed], rng: np.random.Generator) -> Point | None:
    """A point of a room, clear of its walls and of all furniture."""
    low, high = np.min(ring, axis=0), np.max(ring, axis=0)
    for x, y in rng.uniform(low, high, (START_TRIES, 2)).tolist():
        clear = inside(ring, x, y) and min(edge_distances(ring, x, y)) > START_CLEAR_M + 0.1
        if clear and all(math.dist(p[:2], (x, y)) > p.radius + START_CLEAR_M for p in furniture):
            return x, y
    return None


class _Turned:
    """Turns a plan about its origin."""

    def __init__(self, angle: float) -> None:
        self.cos, self.sin, self.degrees = math.cos(angle), math.sin(angle), math.degrees(angle)

    def point(self, p: Point) -> Point:
        return self.cos * p[0] - self.sin * p[1], self.sin * p[0] + self.cos * p[1]

    def line(self, points: Line) -> list[Point]:
        return [self.point(p) for p in points]

    def heading(self, degrees: float) -> float:
        return (degrees + self.degrees + 180.0) % 360.0 - 180.0


def _layout(
    name: str,
    turned: _Turned,
    plan: tuple[list[Space], list[Line], list[Opening], list[Placed], list[tuple[Point, float]]],
    thickness: float,
) -> Layout:
    """The plan as a layout, turned."""
    spaces, walls, doors, furniture, starts = plan
    names = _names(spaces)
    return Layout(
        name=name,
        walls=[{"points": turned.line(wall), "thickness_m": thickness} for wall in walls],
        rooms=[{"name": n, "polygon": turned.line(s.ring)} for n, s in zip(names, spaces, strict=True)],
        doors=[
            {
                "centre": turned.point(door.centre),
                "width_m": door.width,
                "rooms": (names[door.rooms[0]], names[door.rooms[1]]),
                "direction_deg": turned.heading(math.degrees(door.heading)),
            }
            for door in doors
        ],
        obstacles=[_turned_piece(piece.obstacle, turned) for piece in furniture],
        starts=[{"point": turned.point(p), "heading_deg": turned.heading(heading)} for p, heading in starts],
    )


def _turned_piece(piece: dict[str, Any], turned: _Turned) -> dict[str, Any]:
    moved = piece | {"centre": turned.point(piece["centre"])}
    return moved | {"turn_deg": turned.heading(piece["turn_deg"])} if "turn_deg" in piece else moved


def _names(spaces: list[Space]) -> list[str]:
    """room 1, room 2, ..., corridor 1, ..."""
    names, count = [], {True: 0, False: 0}
    for space in spaces:
        count[space.corridor] += 1
        names.append(f"{'corridor' if space.corridor else 'room'} {count[space.corridor]}")
    return names
