"""Compiled functions of faces: distances to them, and the faces of dynamic obstacles.

Compiled functions of the boxes: friction, and what keeps them out of walls and the robot out of them.
"""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.carriers import Array
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


DECELERATION = 1.5  # m/s^2, of a box that slides on felt
TURN_DECELERATION = 8.0  # rad/s^2
DEEPEST_M = 0.05  # what is deeper in a wall is behind it
ROUNDS = 4


@compiled
def slide_boxes(segments: Array, boxes: Array, sizes: Array, dt: float) -> None:
    """The floor slows the boxes (b,6) down for a substep, and the faces (S,2,2) that they entered push them out.

    A box leaves a face that it entered by at most `DEEPEST_M`.
    """
    for i in range(boxes.shape[0]):
        speed, turn = math.hypot(boxes[i, 3], boxes[i, 4]), abs(boxes[i, 5])
        share = max(1.0 - DECELERATION * dt / max(speed, 1e-9), 0.0)
        boxes[i, 3], boxes[i, 4] = share * boxes[i, 3], share * boxes[i, 4]
        boxes[i, 5] *= max(1.0 - TURN_DECELERATION * dt / max(turn, 1e-9), 0.0)
    for _ in range(ROUNDS):
        for i in range(boxes.shape[0]):
            for k in range(segments.shape[0]):
                _leave_face(segments[k], boxes[i], sizes[i])


@compiled
def _leave_face(face: Array, box: Array, size: Array) -> None:
    """Move the box (6,) until none of its corners is behind the face (2,2) and the face does not start in it."""
    reach = 0.5 * math.hypot(size[0], size[1])
    low_x, high_x = min(face[0, 0], face[1, 0]) - reach, max(face[0, 0], face[1, 0]) + reach
    low_y, high_y = min(face[0, 1], face[1, 1]) - reach, max(face[0, 1], face[1, 1]) + reach
    if not (low_x < box[0] < high_x and low_y < box[1] < high_y):
        return
    ux, uy = face[1, 0] - face[0, 0], face[1, 1] - face[0, 1]
    length = math.hypot(ux, uy)
    c, s = math.cos(box[2]), math.sin(box[2])
    for corner in range(4):
        along, aside = BOX_CORNERS[corner, 0] * size[0], BOX_CORNERS[corner, 1] * size[1]
        x, y = box[0] + c * along - s * aside, box[1] + s * along + c * aside
        ahead = ((x - face[0, 0]) * ux + (y - face[0, 1]) * uy) / length
        behind = ((y - face[0, 1]) * ux - (x - face[0, 0]) * uy) / -length
        if 0.0 < ahead < length and 0.0 < behind < DEEPEST_M:
            box[0] -= behind * uy / length
            box[1] += behind * ux / length
    dx, dy = face[0, 0] - box[0], face[0, 1] - box[1]
    along, aside = c * dx + s * dy, c * dy - s * dx
    deep_along, deep_aside = 0.5 * size[0] - abs(along), 0.5 * size[1] - abs(aside)
    if min(deep_along, deep_aside) <= 0.0 or min(deep_along, deep_aside) >= DEEPEST_M:
        return
    if deep_along < deep_aside:
        push = -math.copysign(deep_along, along)
        box[0] += push * c
        box[1] += push * s
    else:
        push = -math.copysign(deep_aside, aside)
        box[0] -= push * s
        box[1] += push * c


@compiled
def leave_boxes(boxes: Array, sizes: Array, state: Array, radius: float) -> bool:
    """Pushes the robot's position out of boxes nearer than `radius`; returns whether there was none."""
    free = True
    for i in range(boxes.shape[0]):
        c, s = math.cos(boxes[i, 2]), math.sin(boxes[i, 2])
        dx, dy = state[0] - boxes[i, 0], state[1] - boxes[i, 1]
        along, aside = c * dx + s * dy, c * dy - s * dx
        near_along = min(max(along, -0.5 * sizes[i, 0]), 0.5 * sizes[i, 0])
        near_aside = min(max(aside, -0.5 * sizes[i, 1]), 0.5 * sizes[i, 1])
        off_along, off_aside = along - near_along, aside - near_aside
        distance = math.hypot(off_along, off_aside)
        if 1e-9 < distance < radius - 1e-9:
            push = radius / distance - 1.0
            state[0] += push * (c * off_along - s * off_aside)
            state[1] += push * (s * off_along + c * off_aside)
            free = False
    return free
