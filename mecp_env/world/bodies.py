"""People and boxes in the pymunk space: people are moved by their own will, boxes by what pushes them."""

from __future__ import annotations

import numpy as np
import pymunk
from numpy.typing import NDArray

from mecp_env.world import crowd_kernels as crowd
from mecp_env.world.box_kernels import drag, settle_boxes
from mecp_env.world.movers import Moving

Array = NDArray[np.float64]

KG_M2 = 15.0  # of a box, by its floor area
ITERATIONS = 20  # of pymunk's solver, where boxes are pushed against others and walls


class Bodies:
    """The bodies of what moves. All that outlives a substep is in the arrays of `Moving`."""

    def __init__(self, space: pymunk.Space, moving: Moving) -> None:
        self._space, self._moving = space, moving
        self._people = [pymunk.Body(body_type=pymunk.Body.KINEMATIC) for _ in moving.people]
        self._boxes = [box_body(size) for size in moving.sizes.tolist()]
        discs = [
            pymunk.Circle(b, r) for b, r in zip(self._people, moving.people[:, crowd.RADIUS].tolist(), strict=True)
        ]
        boxes = [pymunk.Poly.create_box(b, size) for b, size in zip(self._boxes, moving.sizes.tolist(), strict=True)]
        self._shapes = [*discs, *boxes]
        space.add(*self._people, *self._boxes, *self._shapes)
        if self._boxes:
            space.iterations = ITERATIONS

    def enter(self, dt: float, forget: bool) -> None:
        """Tell pymunk where people and boxes are before a substep; people have taken their step already."""
        if forget:  # shapes that were taken out and in have no past
            self._space.remove(*self._shapes)
            self._space.add(*self._shapes)
        for body, person in zip(self._people, self._moving.people.tolist(), strict=True):
            vx, vy = (person[crowd.MOVES] * v for v in (person[crowd.VX], person[crowd.VY]))
            body.position, body.velocity = (person[crowd.X] - vx * dt, person[crowd.Y] - vy * dt), (vx, vy)
        for body, (x, y, turn, vx, vy, spin) in zip(self._boxes, self._moving.boxes.tolist(), strict=True):
            body.position, body.velocity, body.angle, body.angular_velocity = (x, y), (vx, vy), turn, spin

    def leave(self, segments: Array, dt: float) -> None:
        """Take over from pymunk where the boxes are after a substep."""
        boxes = self._moving.boxes
        for row, body in enumerate(self._boxes):
            boxes[row] = *body.position, body.angle, *body.velocity, body.angular_velocity
        drag(boxes, dt)
        settle_boxes(segments, boxes, self._moving.sizes)


def box_body(size: list[float]) -> pymunk.Body:
    """The body of a box of a size (2,) m."""
    mass = KG_M2 * size[0] * size[1]
    return pymunk.Body(mass, pymunk.moment_for_box(mass, (size[0], size[1])))
