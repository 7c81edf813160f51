"""Contacts between bodies: pymunk computes the velocities of robot, pedestrians and boxes after a substep.

Pedestrians move as they choose, whatever touches them; boxes and the robot are pushed. The robot's pose is not taken
from here: it follows from the velocities (drive.py).
"""

from __future__ import annotations

import numpy as np
import pymunk

from mecp_env.core.carriers import Array
from mecp_env.world.config import RobotConfig
from mecp_env.world.drive import (
    AIM_TURN,
    AIM_X,
    FELT_X,
    MovingBodies,
    RobotLimits,
    faces_within,
    furthest,
    may_touch,
)
from mecp_env.world.faces import slide_boxes
from mecp_env.world.pedestrians import MOVES, RADIUS, VX, VY, X, Y

ROBOT_KG = 9.0  # Pioneer P3-DX
KG_M2 = 15.0  # of a box, by its floor area
ITERATIONS = 20  # of pymunk's solver, where boxes are pushed against others and walls


class Bodies:
    """The robot, and the pedestrians, boxes and walls that it or a moving box may touch in the rest of a control step.

    The space is made for one control step: the order of contacts in pymunk, and with it the result, depends on the past
    of a space, and no snapshot could hold that. The shapes are frictionless: they slide along each other.
    """

    def __init__(self, segments: Array, robot: RobotConfig, state: Array, obstacles: MovingBodies) -> None:
        self._segments, self._obstacles, self._dt = segments, obstacles, robot.substep_s
        limits, substeps = RobotLimits.of(robot), robot.arcs * robot.substeps
        met, pushed = may_touch(obstacles, state, limits, substeps)
        self._pedestrians = {row: pymunk.Body(body_type=pymunk.Body.KINEMATIC) for row in np.flatnonzero(met).tolist()}
        self._boxes = {row: box_body(obstacles.sizes[row].tolist()) for row in np.flatnonzero(pushed).tolist()}
        self._robot = pymunk.Body(ROBOT_KG, ROBOT_KG * robot.radius_m**2 / 2.0)
        self._space = space = pymunk.Space()
        space.collision_slop = 0.0
        space.collision_bias = 1.0  # off: pymunk keeps this correction in memory that no snapshot has
        space.collision_persistence = 1  # 0 switches contacts off
        space.iterations = ITERATIONS if self._boxes else space.iterations
        discs = np.vstack([[*state[:2], robot.radius_m], obstacles.box_discs[pushed]])
        discs[:, 2] += furthest(state, limits, substeps)
        for a, b in faces_within(segments, discs).tolist():
            space.add(pymunk.Segment(space.static_body, a, b, 0.0))
        space.add(self._robot, pymunk.Circle(self._robot, robot.radius_m))
        for row, body in self._pedestrians.items():
            space.add(body, pymunk.Circle(body, float(obstacles.pedestrians[row, RADIUS])))
        for row, body in self._boxes.items():
            space.add(body, pymunk.Poly.create_box(body, obstacles.sizes[row].tolist()))

    def substep(self, state: Array, course: Array) -> None:
        """One substep: from the robot's state (6,) and the velocity that its wheels aim at to the one it has then.

        Both velocities are in `course`. The pedestrians have taken their step already; the boxes are moved here.
        """
        self._place_robot(state, course)
        self._place_others()
        self._space.step(self._dt)
        course[FELT_X:] = *self._robot.velocity, self._robot.angular_velocity
        boxes = self._obstacles.boxes
        for row, body in self._boxes.items():
            boxes[row] = *body.position, body.angle, *body.velocity, body.angular_velocity
        slide_boxes(self._segments, boxes, self._obstacles.sizes, self._dt)

    def _place_robot(self, state: Array, course: Array) -> None:
        """Place the robot; pymunk moves a body by its velocity first, and then its force changes the velocity."""
        x, y, angle, vx, vy, spin = state.tolist()
        aim_x, aim_y, aim_turn = course[AIM_X : AIM_TURN + 1].tolist()
        robot, dt = self._robot, self._dt
        robot.position, robot.angle, robot.velocity, robot.angular_velocity = (x, y), angle, (vx, vy), spin
        robot.force = (aim_x - vx) * robot.mass / dt, (aim_y - vy) * robot.mass / dt
        robot.torque = (aim_turn - spin) * robot.moment / dt

    def _place_others(self) -> None:
        """Place pedestrians and boxes."""
        for row, body in self._pedestrians.items():
            walker = self._obstacles.pedestrians[row].tolist()
            vx, vy = (walker[MOVES] * v for v in (walker[VX], walker[VY]))
            body.position = walker[X] - vx * self._dt, walker[Y] - vy * self._dt
            body.velocity = vx, vy
        for row, body in self._boxes.items():
            x, y, turn, vx, vy, spin = self._obstacles.boxes[row].tolist()
            body.position, body.velocity, body.angle, body.angular_velocity = (x, y), (vx, vy), turn, spin


def box_body(size: list[float]) -> pymunk.Body:
    """The body of a box of a size (2,) m."""
    mass = KG_M2 * size[0] * size[1]
    return pymunk.Body(mass, pymunk.moment_for_box(mass, (size[0], size[1])))
