"""Where doorways may be: the shortest lines across the floor between two faces of its walls.

A doorway is narrowest between two faces that are the nearest walls of the middle of the line between them: a circle
over that line is free of walls (a critical point of the Voronoi diagram of the walls, Thrun 1998).
"""

from __future__ import annotations

import math

import numpy as np
import shapely
from shapely.geometry import Polygon

from mecp_env.core.array_types import Array, Bools, Ints
from mecp_env.core.errors import LayoutError
from mecp_env.floorplans.options import Crossing

STRAIGHT = math.radians(12.0)  # a passage nearer to a direction of the building is turned to it
FREE = 0.9  # share of the circle's radius that is free of walls
MAX_PAIRS = 3_000_000  # of faces that are near to each other
LEAST_M = 1e-6  # shorter faces and lines have no direction


def crossings(area: Polygon, faces: Array, axes: tuple[float, ...], width_m: tuple[float, float]) -> list[Crossing]:
    """Lines across `area`, whose walls have `faces` (n,2,2), that are as long as a doorway is wide.

    Each is square to a face at one of its ends, or along one of `axes`, the directions (rad) of the building.
    Raises LayoutError for far too many faces.
    """
    faces = faces[np.linalg.norm(faces[:, 1] - faces[:, 0], axis=1) > LEAST_M]
    tree = shapely.STRtree(shapely.linestrings(faces))
    i, j = _near(tree, faces, width_m[1])
    a, b = _across(faces[i], faces[j])
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
    """Pairs of faces at most `most_m` apart, each in front of the other."""
    i, j = tree.query(tree.geometries, predicate="dwithin", distance=most_m)
    if len(i) > MAX_PAIRS:
        raise LayoutError(f"the floor has {len(i)} pairs of edges within {most_m:g} m, at most {MAX_PAIRS}")
    i, j = i[i < j], j[i < j]
    facing = _is_in_front(faces[i], faces[j]) & _is_in_front(faces[j], faces[i])
    return i[facing], j[facing]


def _is_in_front(faces: Array, others: Array) -> Bools:
    """Whether (n,) an end of each of `others` (n,2,2) is on the floor's side of the line through its face."""
    x, y = np.moveaxis(faces[:, 1] - faces[:, 0], 1, 0)
    off = others - faces[:, :1]
    in_front: Bools = (x[:, None] * off[..., 1] - y[:, None] * off[..., 0]).max(axis=1) > LEAST_M
    return in_front


def _across(first: Array, second: Array) -> tuple[Array, Array]:
    """Ends (n,2) of the shortest line from each of `first` (n,2,2) to one of `second`.

    Faces that are opposite each other and nearly parallel have many; it is the one in the middle.
    """
    lines = shapely.shortest_line(shapely.linestrings(first), shapely.linestrings(second))
    a, b = np.moveaxis(shapely.get_coordinates(lines).reshape(-1, 2, 2), 1, 0)
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
