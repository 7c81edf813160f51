"""Kernels of the boxes: what the floor does to them, and what keeps them out of walls and the robot out of them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.world.faces import box_corner

Array = NDArray[np.float64]

DECELERATION = 1.5  # m/s^2, of a box that slides: it stands on felt
TURN_DECELERATION = 8.0  # rad/s^2
DEEPEST_M = 0.05  # what is deeper in a wall is behind it
ROUNDS = 4


@compiled
def drag(boxes: Array, dt: float) -> None:
    """What the floor takes off the velocities of the boxes (b,6) in a substep."""
    for i in range(boxes.shape[0]):
        speed, turn = math.hypot(boxes[i, 3], boxes[i, 4]), abs(boxes[i, 5])
        share = max(1.0 - DECELERATION * dt / max(speed, 1e-9), 0.0)
        boxes[i, 3], boxes[i, 4] = share * boxes[i, 3], share * boxes[i, 4]
        boxes[i, 5] *= max(1.0 - TURN_DECELERATION * dt / max(turn, 1e-9), 0.0)


@compiled
def settle_boxes(segments: Array, boxes: Array, sizes: Array) -> None:
    """Pushes the boxes out of the faces (S,2,2) that they entered by at most `DEEPEST_M`."""
    for _ in range(ROUNDS):
        for i in range(boxes.shape[0]):
            _leave_walls(segments, boxes[i], sizes[i])


@compiled
def _leave_walls(segments: Array, box: Array, size: Array) -> None:
    """Moves one box out of the faces (S,2,2), one after another."""
    reach = 0.5 * math.hypot(size[0], size[1])
    for k in range(segments.shape[0]):
        if _may_touch(segments[k], box, reach):
            _leave_face(segments[k], box, size)
            _leave_post(segments[k, 0], box, size)


@compiled
def _may_touch(face: Array, box: Array, reach: float) -> bool:
    """False where the face (2,2) lies out of the box's reach."""
    low_x, high_x = min(face[0, 0], face[1, 0]) - reach, max(face[0, 0], face[1, 0]) + reach
    low_y, high_y = min(face[0, 1], face[1, 1]) - reach, max(face[0, 1], face[1, 1]) + reach
    return bool(low_x < box[0] < high_x and low_y < box[1] < high_y)


@compiled
def _leave_face(face: Array, box: Array, size: Array) -> None:
    """Moves the box so that none of its corners is behind the face (2,2)."""
    ux, uy = face[1, 0] - face[0, 0], face[1, 1] - face[0, 1]
    length = math.hypot(ux, uy)
    for corner in range(4):
        x, y = box_corner(box, size, corner)
        along = ((x - face[0, 0]) * ux + (y - face[0, 1]) * uy) / length
        behind = ((y - face[0, 1]) * ux - (x - face[0, 0]) * uy) / -length
        if 0.0 < along < length and 0.0 < behind < DEEPEST_M:
            box[0] -= behind * uy / length
            box[1] += behind * ux / length


@compiled
def _leave_post(post: Array, box: Array, size: Array) -> None:
    """Moves the box so that a corner (2,) of a wall does not lie in it."""
    c, s = math.cos(box[2]), math.sin(box[2])
    dx, dy = post[0] - box[0], post[1] - box[1]
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
