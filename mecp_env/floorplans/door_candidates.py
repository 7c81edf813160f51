"""Where doorways may be: the shortest lines across the floor between two faces of its walls.

A doorway is narrowest between two faces that are the nearest walls of the middle of the line between them: a circle
over that line is free of walls (a critical point of the Voronoi diagram of the walls, Thrun 1998).
"""

from __future__ import annotations

import math

import numpy as np
import shapely
from shapely.geometry import Polygon

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.errors import LayoutError
from mecp_env.floorplans.options import Crossing

STRAIGHT = math.radians(12.0)  # a passage nearer to a direction of the building is turned to it
FREE = 0.9  # share of the circle's radius that is free of walls
MAX_PAIRS = 3_000_000  # of faces that are near to each other
CHUNK = 500  # faces whose neighbours are sought at once, which bounds the memory
LEAST_M = 1e-6  # shorter faces and lines have no direction


def crossings(area: Polygon, faces: Array, axes: tuple[float, ...], width_m: tuple[float, float]) -> list[Crossing]:
    """Lines across `area`, whose walls have `faces` (n,2,2), that are as long as a doorway is wide.

    Each is square to a face at one of its ends, or along one of `axes`, the directions (rad) of the building.
    Raises LayoutError for far too many faces.
    """
    faces = faces[np.linalg.norm(faces[:, 1] - faces[:, 0], axis=1) > LEAST_M]
    tree = shapely.STRtree(shapely.linestrings(faces))
    i, j = _near(tree, faces, width_m[1])
    lines = shapely.shortest_line(tree.geometries[i], tree.geometries[j])
    a, b = _across(faces[i], faces[j], shapely.get_coordinates(lines).reshape(-1, 2, 2))
    middle, width = (a + b) / 2.0, np.linalg.norm(b - a, axis=1)
    fits = (width >= max(width_m[0], LEAST_M)) & (width <= width_m[1])
    i, j, a, b, middle, width = (column[fits] for column in (i, j, a, b, middle, width))
    along = (b - a) / width[:, None]
    fits = _is_square(along, faces[i], faces[j], axes) & shapely.contains_xy(area, middle)
    fits[fits] = _clearance(tree, middle[fits]) > FREE * 0.5 * width[fits]
    return [Crossing(*pair) for pair in zip(middle[fits], along[fits], strict=True)]


def wall_faces(area: Polygon) -> Array:
    """Faces (n,2,2) of all rings of `area`, the floor on their left."""
    rings = [np.array(ring.coords) for ring in (area.exterior, *area.interiors)]
    return np.concatenate([np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings])


def _near(tree: shapely.STRtree, faces: Array, most_m: float) -> tuple[Ints, Ints]:
    """Pairs of faces about `most_m` apart at most, each in front of the other."""
    around = shapely.box(*(faces.min(axis=1) - most_m).T, *(faces.max(axis=1) + most_m).T)
    near, boxes = [np.empty((2, 0), np.int64)], 0
    for first in range(0, len(faces), CHUNK):
        i, j = tree.query(around[first : first + CHUNK])
        boxes += len(i)
        if boxes > MAX_PAIRS >= boxes - len(i):
            _require_few(tree, most_m)
        i, j = (i + first)[i + first < j], j[i + first < j]
        fits = _is_in_front(faces[i], faces[j]) & _is_in_front(faces[j], faces[i])
        fits[fits] = _distance(faces[i[fits]], faces[j[fits]]) < most_m + LEAST_M
        near.append(np.stack([i[fits], j[fits]]))
    i, j = np.concatenate(near, axis=1)
    return i, j


def _require_few(tree: shapely.STRtree, most_m: float) -> None:
    """Raises LayoutError for far too many pairs of faces within `most_m`; this takes longer than counting boxes."""
    pairs = tree.query(tree.geometries, predicate="dwithin", distance=most_m).shape[1]
    if pairs > MAX_PAIRS:
        raise LayoutError(f"the floor has {pairs} pairs of edges within {most_m:g} m, at most {MAX_PAIRS}")


def _distance(first: Array, second: Array) -> Array:
    """Distance (n,), m, between faces (n,2,2) that do not cross: that of an end of one from the other."""
    off = [_off(ends[:, k], face) for ends, face in ((first, second), (second, first)) for k in (0, 1)]
    distance: Array = np.minimum.reduce(off)
    return distance


def _off(point: Array, face: Array) -> Array:
    """Distance (n,), m, of points (n,2) from faces (n,2,2)."""
    (x, y), (u, v) = (point - face[:, 0]).T, (face[:, 1] - face[:, 0]).T
    share = np.clip((x * u + y * v) / (u * u + v * v), 0.0, 1.0)
    off: Array = np.hypot(x - share * u, y - share * v)
    return off


def _is_in_front(faces: Array, others: Array) -> Bools:
    """Whether (n,) an end of each of `others` (n,2,2) is on the floor's side of the line through its face."""
    x, y = np.moveaxis(faces[:, 1] - faces[:, 0], 1, 0)
    off = others - faces[:, :1]
    in_front: Bools = (x[:, None] * off[..., 1] - y[:, None] * off[..., 0]).max(axis=1) > LEAST_M
    return in_front


def _across(first: Array, second: Array, shortest: Array) -> tuple[Array, Array]:
    """Ends (n,2) of the `shortest` line (n,2,2) from each of the faces `first` (n,2,2) to one of `second`.

    Faces that are opposite each other and nearly parallel have many; it is the one in the middle.
    """
    a, b = shortest[:, 0].copy(), shortest[:, 1].copy()
    step, turn = first[:, 1] - first[:, 0], second[:, 1] - second[:, 0]
    share = np.einsum("nkc,nc->nk", second - first[:, :1], step) / np.sum(step**2, axis=1)[:, None]
    low, high = np.clip(np.sort(share, axis=1), 0.0, 1.0).T
    cosine = np.sum(step * turn, axis=1) / np.linalg.norm(step, axis=1) / np.linalg.norm(turn, axis=1)
    opposite = (np.abs(cosine) > math.cos(STRAIGHT)) & (high > low)
    where = (low + high) / 2.0
    on_second = (where - share[:, 0]) / np.where(opposite, share[:, 1] - share[:, 0], 1.0)
    a[opposite] = (first[:, 0] + where[:, None] * step)[opposite]
    b[opposite] = (second[:, 0] + on_second[:, None] * turn)[opposite]
    return a, b


def _is_square(along: Array, first: Array, second: Array, axes: tuple[float, ...]) -> Bools:
    """Whether (n,) the unit vectors `along` (n,2) are square to one of two faces each, or along one of `axes`."""
    faces = np.stack([first, second], axis=1)
    step = faces[:, :, 1] - faces[:, :, 0]
    sine = np.einsum("nc,nfc->nf", along, step / np.linalg.norm(step, axis=2)[..., None])
    heading = np.arctan2(along[:, 1], along[:, 0])[:, None] - np.array(axes)
    off = np.mod(heading + math.pi / 4.0, math.pi / 2.0) - math.pi / 4.0
    square: Bools = (np.abs(sine) < math.sin(STRAIGHT)).any(axis=1) | (np.abs(off) < STRAIGHT).any(axis=1)
    return square


def _clearance(tree: shapely.STRtree, points: Array) -> Array:
    """Distance (n,), m, from points (n,2) to the nearest wall."""
    distance: Array = tree.query_nearest(shapely.points(points), all_matches=False, return_distance=True)[1]
    return distance
