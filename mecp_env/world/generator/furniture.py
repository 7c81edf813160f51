"""Furniture that leaves every way open: clear of doors, of other pieces, and of walls or flush with one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from mecp_env.world.generator.doorplan import Opening
from mecp_env.world.generator.partition import Point, Space
from mecp_env.world.generator.spec import GeneratorSpec

CLEAR_M = 0.8  # between two pieces, and between a piece and a wall that it does not stand against
DOOR_CLEAR_M = 1.1  # between a piece and the middle of a door
TRIES = 4  # to find a place for a piece


class Placed(NamedTuple):
    """A piece of furniture by a circle around it, and as the layout has it."""

    x: float
    y: float
    radius: float
    obstacle: dict[str, Any]


def furnish(
    spaces: list[Space], doors: list[Opening], thickness: float, spec: GeneratorSpec, rng: np.random.Generator
) -> list[Placed]:
    """The furniture of all rooms but the corridors; fewer pieces than asked for where there is no room for them."""
    placed: list[Placed] = []
    for index, space in enumerate(spaces):
        if space.corridor:
            continue
        count = rng.poisson(spec.furniture * ring_area(space.ring) / 10.0)
        here = [door.centre for door in doors if index in door.rooms]
        mine: list[Placed] = []
        for kind in rng.choice(spec.pieces, count).tolist():
            piece = _try(kind, space.ring, thickness, here, mine, rng)
            mine += [piece] if piece is not None else []
        placed += mine
    return placed


def ring_area(ring: Sequence[Point]) -> float:
    """Area of a simple polygon, m^2."""
    return 0.5 * abs(sum(a[0] * b[1] - b[0] * a[1] for a, b in pairwise([*ring, ring[0]])))


def inside(ring: Sequence[Point], x: float, y: float) -> bool:
    """True when the point lies in the simple polygon."""
    crossings = 0
    for (x0, y0), (x1, y1) in pairwise([*ring, ring[0]]):
        crossings += (y0 > y) != (y1 > y) and x < (x1 - x0) * (y - y0) / (y1 - y0) + x0
    return crossings % 2 == 1


def edge_distances(ring: Sequence[Point], x: float, y: float) -> list[float]:
    """Distance of a point from each edge of a ring, m."""
    distances = []
    for (x0, y0), (x1, y1) in pairwise([*ring, ring[0]]):
        dx, dy = x1 - x0, y1 - y0
        t = min(max(((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy), 0.0), 1.0)
        distances.append(math.hypot(x - x0 - t * dx, y - y0 - t * dy))
    return distances


def _try(
    kind: str, ring: list[Point], thickness: float, doors: list[Point], placed: list[Placed], rng: np.random.Generator
) -> Placed | None:
    """A piece where it is in nobody's way, or None after a few tries."""
    for _ in range(TRIES):
        piece, wall = _shelf(ring, thickness, rng) if kind == "shelf" else (_standing(kind, ring, rng), -1)
        if _is_clear(piece, ring, wall, thickness) and _is_free(piece, doors, placed):
            return piece
    return None


def _is_clear(piece: Placed, ring: list[Point], wall: int, thickness: float) -> bool:
    """True when a piece stands in the room, away from every wall but the one that it stands against (-1: none)."""
    least = piece.radius + CLEAR_M + thickness / 2.0
    far = edge_distances(ring, piece.x, piece.y)
    return inside(ring, piece.x, piece.y) and all(d >= least for edge, d in enumerate(far) if edge != wall)


def _is_free(piece: Placed, doors: list[Point], placed: list[Placed]) -> bool:
    """True when a piece stands away from the doors and from the other pieces."""
    free = all(math.dist(door, piece[:2]) >= piece.radius + DOOR_CLEAR_M for door in doors)
    return free and all(math.dist(p[:2], piece[:2]) >= p.radius + piece.radius + CLEAR_M for p in placed)


def _standing(kind: str, ring: list[Point], rng: np.random.Generator) -> Placed:
    """A pillar or a box anywhere in the box around a room."""
    x, y = (float(rng.uniform(min(values), max(values))) for values in zip(*ring, strict=True))
    centre = (round(x, 3), round(y, 3))
    if kind == "round_pillar":
        radius = round(float(rng.uniform(0.15, 0.3)), 3)
        return Placed(*centre, radius, {"kind": "round", "centre": centre, "radius_m": radius})
    low, high = (0.25, 0.5) if kind == "square_pillar" else (0.4, 1.0)
    width, depth = (round(float(size), 3) for size in rng.uniform(low, high, 2))
    size = (width, width) if kind == "square_pillar" else (width, depth)
    turn = 0.0 if kind == "square_pillar" else round(float(rng.choice([0.0, rng.uniform(-45.0, 45.0)])), 2)
    return Placed(*centre, math.hypot(*size) / 2.0, {"kind": "box", "centre": centre, "size": size, "turn_deg": turn})


def _shelf(ring: list[Point], thickness: float, rng: np.random.Generator) -> tuple[Placed, int]:
    """A shelf with its back to a wall of the room, and which wall that is."""
    wall = int(rng.integers(len(ring)))
    (x0, y0), (x1, y1) = ring[wall], ring[(wall + 1) % len(ring)]
    long = math.hypot(x1 - x0, y1 - y0)
    length, depth = (round(float(size), 3) for size in (rng.uniform(0.8, 2.0), rng.uniform(0.3, 0.5)))
    along, off = float(rng.uniform(0.0, long)), (depth + thickness) / 2.0
    ux, uy = (x1 - x0) / long, (y1 - y0) / long
    centre = (x0 + along * ux - off * uy, y0 + along * uy + off * ux)
    turn = math.degrees(math.atan2(uy, ux))
    obstacle = {"kind": "box", "centre": centre, "size": (length, depth), "turn_deg": turn}
    return Placed(*centre, math.hypot(length, depth) / 2.0, obstacle), wall
