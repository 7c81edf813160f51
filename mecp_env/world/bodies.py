"""Pedestrians and boxes in the pymunk space: pedestrians choose their motion, boxes are pushed."""

from __future__ import annotations

import numpy as np
import pymunk
from numpy.typing import NDArray

from mecp_env.world import pedestrians as crowd
from mecp_env.world.boxes import drag, settle_boxes
from mecp_env.world.moving_obstacles import Moving

Array = NDArray[np.float64]

KG_M2 = 15.0  # of a box, by its floor area
ITERATIONS = 20  # of pymunk's solver, where boxes are pushed against others and walls


class Bodies:
    """The bodies of what moves. All that outlives a substep is in the arrays of `Moving`."""

    def __init__(self, space: pymunk.Space, moving: Moving) -> None:
        self._space, self._moving = space, moving
        self._people = [pymunk.Body(body_type=pymunk.Body.KINEMATIC) for _ in moving.people]
        self._boxes = [box_body(size) for size in moving.sizes.tolist()]
        radii = moving.people[:, crowd.RADIUS].tolist()
        self._discs = [pymunk.Circle(body, radius) for body, radius in zip(self._people, radii, strict=True)]
        sizes = moving.sizes.tolist()
        self._blocks = [pymunk.Poly.create_box(body, size) for body, size in zip(self._boxes, sizes, strict=True)]
        self._inside: list[int] = []  # of the people, whose shapes are in the space
        space.add(*self._people, *self._boxes, *self._blocks)
        if self._boxes:
            space.iterations = ITERATIONS

    def enter(self, near: list[int], dt: float, forget: bool) -> None:
        """Tell pymunk where boxes are before a substep, and the people who are `near` something that they can touch.

        The people have taken their step already.
        """
        if forget or near != self._inside:
            self._let_in(near, forget)
        for i in near:
            body, person = self._people[i], self._moving.people[i].tolist()
            vx, vy = (person[crowd.MOVES] * v for v in (person[crowd.VX], person[crowd.VY]))
            body.position, body.velocity = (person[crowd.X] - vx * dt, person[crowd.Y] - vy * dt), (vx, vy)
        for body, (x, y, turn, vx, vy, spin) in zip(self._boxes, self._moving.boxes.tolist(), strict=True):
            body.position, body.velocity, body.angle, body.angular_velocity = (x, y), (vx, vy), turn, spin

    def _let_in(self, near: list[int], forget: bool) -> None:
        """Have the shapes of these people in the space; to `forget`, all go out and in: then they have no past."""
        stay = set() if forget else set(self._inside) & set(near)
        blocks = self._blocks if forget else []
        leave = [self._discs[i] for i in self._inside if i not in stay] + blocks
        come = [self._discs[i] for i in near if i not in stay] + blocks
        self._space.remove(*leave)
        self._space.add(*come)
        self._inside = near

    def leave(self, segments: Array, dt: float) -> None:
        """Take over from pymunk where the boxes are after a substep."""
        if not self._boxes:
            return
        boxes = self._moving.boxes
        for row, body in enumerate(self._boxes):
            boxes[row] = *body.position, body.angle, *body.velocity, body.angular_velocity
        drag(boxes, dt)
        settle_boxes(segments, boxes, self._moving.sizes)


def box_body(size: list[float]) -> pymunk.Body:
    """The body of a box of a size (2,) m."""
    mass = KG_M2 * size[0] * size[1]
    return pymunk.Body(mass, pymunk.moment_for_box(mass, (size[0], size[1])))
