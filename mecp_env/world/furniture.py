"""Furniture that keeps every path open: clear of doors, other pieces and walls, or flush with one wall.

A piece is covered by circles, so that all distances are those of points, for many candidate places at a time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from mecp_env.core.carriers import Array, Bools
from mecp_env.world.config import GeneratorSpec, Rejected
from mecp_env.world.partition import Opening, Point, Space

CLEAR_M = 0.8  # between two pieces, and between a piece and a wall that is not behind it
DOOR_CLEAR_M = 1.1  # between a piece and the middle of a door
PLACES = 32  # candidate places of a piece in a room
ROUNDS = 3  # attempts to put the remaining pieces into any room
LEAST_SHARE = 0.85  # of the pieces that are asked for


class Places(NamedTuple):
    """Candidate places of a piece."""

    centres: Array  # (m,k,2) m, of its circles
    radius: float  # m, of each
    wall: NDArray[np.int64]  # (m,) the wall behind it, or -1
    middles: Array  # (m,2) m, of the piece
    piece: dict[str, Any]  # as the layout has it, without its place
    turns: Array | None = None  # (m,) degrees, where the wall turns it

    def obstacle(self, place: int) -> dict[str, Any]:
        """The piece at a place, as the layout has it."""
        x, y = self.middles[place].tolist()
        turn = {} if self.turns is None else {"turn_deg": float(self.turns[place])}
        return self.piece | turn | {"centre": (x, y)}


def furnish(
    spaces: list[Space], doors: list[Opening], thickness: float, spec: GeneratorSpec, rng: np.random.Generator
) -> list[Room]:
    """All rooms but the corridors, with as many pieces of furniture as the specification says. Raises `Rejected`.

    Each room has its share; what does not fit there is put into another one.
    """
    rooms = [_room(index, space, doors, thickness) for index, space in enumerate(spaces) if not space.corridor]
    areas = np.array([ring_area(room.ring.tolist()) for room in rooms])
    wanted = spec.furniture * float(areas.sum()) / 10.0
    if wanted == 0.0:
        return rooms
    shares = zip(rooms, _counts(areas, round(wanted), rng), strict=True)
    left: list[str] = []
    for room, count in shares:
        left += [kind for kind in rng.choice(spec.pieces, count).tolist() if not room.put(kind, rng)]
    _elsewhere(left, rooms, spec, rng)
    placed = sum(len(room.pieces) for room in rooms)
    if placed < min(round(wanted), LEAST_SHARE * wanted):
        raise Rejected("furniture", spec.furniture * placed / wanted)
    return rooms


def _counts(areas: Array, total: int, rng: np.random.Generator) -> list[int]:
    """So many pieces in all, for each room by its area, rounded up or down by chance."""
    ends = np.floor(np.cumsum(areas) * (total / float(areas.sum())) + rng.uniform(1e-6, 1.0 - 1e-6))
    counts: list[int] = np.diff(ends, prepend=0.0).astype(np.int64).tolist()
    return counts


def _elsewhere(kinds: list[str], rooms: list[Room], spec: GeneratorSpec, rng: np.random.Generator) -> None:
    """Put pieces into any rooms; in the last round pieces of any kind that may be."""
    for turn in range(ROUNDS):
        tried = rng.choice(spec.pieces, len(kinds)).tolist() if turn == ROUNDS - 1 else kinds
        orders = [rng.permutation(len(rooms)).tolist() for _ in kinds]
        kinds = [k for k, order in zip(tried, orders, strict=True) if not any(rooms[i].put(k, rng) for i in order)]


@dataclass(slots=True)
class Room:
    """A room and its furniture."""

    ring: Array  # (n,2) m
    doors: Array  # (d,2) m, their middles
    thickness: float  # m, of the walls
    circles: Array = field(default_factory=lambda: np.empty((0, 3)))  # x, y, radius, m: around all pieces
    pieces: list[dict[str, Any]] = field(default_factory=list)  # as the layout has them

    def put(self, kind: str, rng: np.random.Generator) -> bool:
        """Place a piece where it blocks no passage; False where no such place was found."""
        places = _shelf(self.ring, self.thickness, rng) if kind == "shelf" else _free_standing(kind, self, rng)
        clear = _is_off(places, self.circles, CLEAR_M) & _is_off(places, self.doors, DOOR_CLEAR_M)
        fits = np.flatnonzero(clear & _is_off_walls(places, self))
        if not len(fits):
            return False
        first = int(fits[0])
        circles = np.pad(places.centres[first], ((0, 0), (0, 1)), constant_values=places.radius)
        self.pieces.append(places.obstacle(first))
        self.circles = np.concatenate([self.circles, circles])
        return True


def _room(index: int, space: Space, doors: list[Opening], thickness: float) -> Room:
    here = [door.centre for door in doors if index in door.rooms]
    return Room(np.array(space.ring), np.array(here).reshape(-1, 2), thickness)


def ring_area(ring: Sequence[Point]) -> float:
    """Area of a simple polygon, m^2."""
    return 0.5 * abs(sum(a[0] * b[1] - b[0] * a[1] for a, b in pairwise([*ring, ring[0]])))


def inside(ring: Array, points: Array) -> Bools:
    """Which points (m,2) lie in the simple polygon (n,2)."""
    within: Bools = shapely.contains_xy(shapely.Polygon(ring), points)
    return within


def edge_distances(ring: Array, points: Array) -> Array:
    """Distances (...,n) m of points (...,2) from each edge of a ring (n,2)."""
    (x0, y0), (dx, dy) = ring.T, (np.roll(ring, -1, axis=0) - ring).T
    x, y = points[..., :1] - x0, points[..., 1:] - y0
    share = np.minimum(np.maximum((x * dx + y * dy) / (dx * dx + dy * dy), 0.0), 1.0)
    far: Array = np.hypot(x - share * dx, y - share * dy)
    return far


def _is_off_walls(places: Places, room: Room) -> Bools:
    """At which places (m,) a piece is in the room, away from walls, except the wall behind it."""
    far = edge_distances(room.ring, places.centres).min(axis=1)
    own = places.wall[:, None] == np.arange(len(room.ring))
    least = places.radius + CLEAR_M + room.thickness / 2.0
    clear: Bools = (far + np.where(own, np.inf, 0.0)).min(axis=1) >= least
    return clear & inside(room.ring, places.centres.mean(axis=1))


def _is_off(places: Places, others: Array, least_m: float) -> Bools:
    """At which places (m,) a piece keeps so far from points (n,2) or circles (n,3)."""
    if not len(others):
        return np.ones(len(places.centres), np.bool_)
    gap = np.hypot(places.centres[..., :1] - others[:, 0], places.centres[..., 1:] - others[:, 1]) - places.radius
    gap -= others[:, 2] if others.shape[1] == 3 else 0.0
    off: Bools = gap.min(axis=(1, 2)) >= least_m
    return off


def _free_standing(kind: str, room: Room, rng: np.random.Generator) -> Places:
    """A pillar or a box anywhere in the box around a room."""
    centres = rng.uniform(room.ring.min(axis=0), room.ring.max(axis=0), (PLACES, 2)).round(3)
    offsets, radius, piece = _piece(kind, rng)
    return Places(centres[:, None] + offsets, radius, np.full(PLACES, -1), centres, piece)


def _piece(kind: str, rng: np.random.Generator) -> tuple[Array, float, dict[str, Any]]:
    """A pillar or a box without a place: its circles around its middle, their radius, and as the layout has it."""
    if kind == "round_pillar":
        radius = round(float(rng.uniform(0.15, 0.3)), 3)
        return np.zeros((1, 2)), radius, {"kind": "round", "radius_m": radius}
    low, high = (0.25, 0.5) if kind == "square_pillar" else (0.4, 1.0)
    width, depth = (round(float(size), 3) for size in rng.uniform(low, high, 2))
    if kind == "square_pillar":
        return *_cover((width, width), 0.0), {"kind": "box", "size": (width, width), "turn_deg": 0.0}
    turn = round((0.0, rng.uniform(-45.0, 45.0))[rng.integers(2)], 2)
    return *_cover((width, depth), math.radians(turn)), {"kind": "box", "size": (width, depth), "turn_deg": turn}


def _shelf(ring: Array, thickness: float, rng: np.random.Generator) -> Places:
    """A shelf with its back to a wall of the room."""
    length, depth = (round(float(size), 3) for size in (rng.uniform(0.8, 2.0), rng.uniform(0.3, 0.5)))
    wall = rng.integers(len(ring), size=PLACES)
    ahead = (np.roll(ring, -1, axis=0) - ring)[wall]
    ahead /= np.hypot(ahead[:, :1], ahead[:, 1:])
    share = rng.uniform(0.0, 1.0, (PLACES, 1))
    centres = ring[wall] * (1.0 - share) + np.roll(ring, -1, axis=0)[wall] * share
    centres += (depth + thickness) / 2.0 * np.column_stack([-ahead[:, 1], ahead[:, 0]])
    offsets, radius = _cover((length, depth), 0.0)
    circles = centres[:, None] + offsets[:, :1] * ahead[:, None]
    turns = np.degrees(np.arctan2(ahead[:, 1], ahead[:, 0]))
    return Places(circles, radius, wall, centres, {"kind": "box", "size": (length, depth)}, turns)


def _cover(size: tuple[float, float], turn: float) -> tuple[Array, float]:
    """Circles that cover a rectangle along its longer side: centres (k,2) from its middle, and their radius, m."""
    long, short = max(size), min(size)
    count = max(1, round(long / short))
    along = (np.arange(count) + 0.5 - count / 2.0) * long / count
    turn += 0.0 if size[0] >= size[1] else math.pi / 2.0
    return np.outer(along, (math.cos(turn), math.sin(turn))), math.hypot(long / count, short) / 2.0
