"""Compiled functions of faces: distances to them, and the faces of dynamic obstacles."""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.array_types import Array
from mecp_env.core.jit import compiled

SIDES = 16  # of the polygon that represents a pedestrian for the laser
BOX_CORNERS = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])  # of a unit box, counter-clockwise


@compiled
def from_face(segments: Array, k: int, x: float, y: float) -> tuple[float, float]:
    """Vector to (x, y) from the nearest point of face k."""
    ax, ay = segments[k, 0, 0], segments[k, 0, 1]
    ux, uy = segments[k, 1, 0] - ax, segments[k, 1, 1] - ay
    share = min(max(((x - ax) * ux + (y - ay) * uy) / (ux * ux + uy * uy), 0.0), 1.0)
    return x - ax - share * ux, y - ay - share * uy


@compiled
def moving_faces(discs: Array, boxes: Array, sizes: Array) -> Array:
    """Faces (m,2,2) of discs (n,3), as polygons of 16 sides, and of boxes (b,>=3) of sizes (b,2); free to the left.

    Discs: place, radius; boxes: place, turn.
    """
    faces = np.empty((SIDES * discs.shape[0] + 4 * boxes.shape[0], 2, 2))
    rim = np.empty((SIDES + 1, 2))
    for k in range(SIDES + 1):
        angle = -k * (2.0 * math.pi / SIDES)
        rim[k, 0], rim[k, 1] = math.cos(angle), math.sin(angle)
    n = 0
    for i in range(discs.shape[0]):
        for k in range(SIDES):
            for end in range(2):
                faces[n, end, 0] = discs[i, 0] + discs[i, 2] * rim[k + end, 0]
                faces[n, end, 1] = discs[i, 1] + discs[i, 2] * rim[k + end, 1]
            n += 1
    corners = box_corners(boxes, sizes)
    for i in range(boxes.shape[0]):
        for k in range(4):
            for end in range(2):
                corner = 4 * i + (8 - k - end) % 4
                faces[n, end, 0], faces[n, end, 1] = corners[corner, 0], corners[corner, 1]
            n += 1
    return faces


@compiled
def box_corners(boxes: Array, sizes: Array) -> Array:
    """(4b,2) m: the corners of boxes (b,>=3) of sizes (b,2), counter-clockwise."""
    corners = np.empty((4 * boxes.shape[0], 2))
    for i in range(boxes.shape[0]):
        c, s = math.cos(boxes[i, 2]), math.sin(boxes[i, 2])
        for k in range(4):
            along, aside = BOX_CORNERS[k, 0] * sizes[i, 0], BOX_CORNERS[k, 1] * sizes[i, 1]
            corners[4 * i + k, 0] = boxes[i, 0] + c * along - s * aside
            corners[4 * i + k, 1] = boxes[i, 1] + s * along + c * aside
    return corners
