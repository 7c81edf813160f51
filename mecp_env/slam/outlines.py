"""Outlines of rooms and doors as rings of points, from the cells of the grid and from jambs: polygons of GeoJSON."""

from __future__ import annotations

import math
from collections import defaultdict

import numpy as np
from scipy import ndimage

from mecp_env.core.carriers import Array, Bools
from mecp_env.slam.messages import Belief, Door, SemanticGrid

Ring = Array  # (n,2), closed: the last point is the first; counter-clockwise around floor, clockwise around a hole
Vertex = tuple[int, int]  # column, row of a corner of a cell


def room_outline(grid: SemanticGrid, room: int) -> list[list[Ring]]:
    """The parts of a room, each as its outer ring and those of its holes, in metres of the map frame."""
    labels, count = ndimage.label(grid.room == room)
    parts = [rings_of(labels == part) for part in range(1, count + 1)]
    return [[ring * grid.resolution_m + grid.origin for ring in rings] for rings in parts]


def rings_of(cells: Bools) -> list[Ring]:
    """The rings around connected cells (H,W), the outer one first; none touches itself."""
    after = _edges(cells)
    rings = [ring for first in sorted(after) for walk in _walks(after, first) for ring in _simple(walk)]
    return sorted((_corners(np.array(ring, np.float64)) for ring in rings), key=area, reverse=True)


def area(ring: Ring) -> float:
    """The area in a ring, negative where it is clockwise."""
    x, y = ring.T
    return 0.5 * float(x[:-1] @ y[1:] - x[1:] @ y[:-1])


def _edges(cells: Bools) -> dict[Vertex, list[Vertex]]:
    """From each vertex to the next ones along the edges of the cells, which have the cell on their left."""
    inside = np.pad(cells, 1)
    after: dict[Vertex, list[Vertex]] = defaultdict(list)
    for (dx, dy), (x, y) in (((0, -1), (0, 0)), ((1, 0), (1, 0)), ((0, 1), (1, 1)), ((-1, 0), (0, 1))):
        beyond = np.roll(inside, (-dy, -dx), (0, 1))[1:-1, 1:-1]
        for row, column in np.argwhere(cells & ~beyond).tolist():
            start = column + x, row + y
            after[start].append((start[0] - dy, start[1] + dx))
    return after


def _walks(after: dict[Vertex, list[Vertex]], first: Vertex) -> list[list[Vertex]]:
    """Every closed walk from a vertex along edges that no walk has taken yet; each is taken out of `after`."""
    walks = []
    while after[first]:
        walk = [first, after[first].pop()]
        while walk[-1] != first:
            walk.append(after[walk[-1]].pop())
        walks.append(walk)
    return walks


def _simple(walk: list[Vertex]) -> list[list[Vertex]]:
    """A closed walk cut where it comes back to a vertex: rings that visit each vertex once."""
    rings, path, at = [], list[Vertex](), dict[Vertex, int]()
    for vertex in walk:
        if vertex in at:
            loop = path[at[vertex] :]
            rings.append([*loop, vertex])
            del path[-len(loop) :]
            for left in loop:
                del at[left]
        at[vertex] = len(path)
        path.append(vertex)
    return rings


def _corners(ring: Ring) -> Ring:
    """The ring without the points between its corners."""
    before, points, after = np.roll(ring[:-1], 1, axis=0), ring[:-1], np.roll(ring[:-1], -1, axis=0)
    turns = ((points - before) != (after - points)).any(axis=1)
    kept = points[turns]
    return np.concatenate([kept, kept[:1]])


def door_outline(belief: Belief, door: Door, cell_m: float) -> Ring:
    """The ring through the jambs of both faces; of one face, or of two that are one line, a strip as wide as a cell."""
    faces = [belief.p_map[belief.rows(np.array(pair))] for pair in (door.jambs, door.other_face) if pair]
    around = np.concatenate(faces)
    offset = around - around.mean(axis=0)
    ring = around[np.argsort(np.arctan2(offset[:, 1], offset[:, 0]))]
    ring = np.concatenate([ring, ring[:1]])
    return ring if area(ring) > cell_m**2 else _strip(faces[0][0], faces[0][1], cell_m)


def _strip(right: Array, left: Array, width_m: float) -> Ring:
    """The rectangle along a face, half of its width on each side."""
    along = (left - right) / max(math.dist(left, right), 1e-9)
    side = 0.5 * width_m * np.array([-along[1], along[0]])
    return np.array([right - side, left - side, left + side, right + side, right - side])
