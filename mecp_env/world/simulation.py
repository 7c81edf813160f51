"""The physics: a circular differential-drive robot among walls, pedestrians and boxes; contacts by pymunk.

One `step()` is one control step of many substeps. In each, the body first moves with its velocity, then the wheels set
a new one (towards the command, within the acceleration limits, without sideways motion), and contacts correct it. So
the velocity of a body in contact never points into the wall, and the little by which it enters a wall when it first
touches it is undone at once. One compiled function does all this (drive.py); while something that moves is within the
robot's reach, or a box slides, pymunk decides what the contacts do to the velocities (bodies.py). Only the six numbers
of the state, and the arrays of what moves, outlive a control step: a restored state continues bit for bit.

Pedestrians move as they choose, whatever touches them; boxes and the robot are pushed. The robot's pose is not taken
from here: it follows from the velocities (drive.py).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pymunk

from mecp_env.core.carriers import Array, carrier
from mecp_env.core.se2 import wrap_angle
from mecp_env.world.config import RobotConfig
from mecp_env.world.drive import (
    AIM_TURN,
    AIM_X,
    COURSE,
    FELT_X,
    SPEED,
    TURN,
    MovingBodies,
    RobotLimits,
    drive_on,
    faces_within,
    furthest,
    may_touch,
    slide_boxes,
)
from mecp_env.world.moving_obstacles import Movers, no_movers, robot_row
from mecp_env.world.outline import Outline
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


@carrier
class Motion:
    """What the body truly did in one step, arc by arc; while it turns faster and faster, an arc leaves 0.1 mm out."""

    increments: Array  # (M,2) m, rad: signed distance along the mean heading of the arc, turn
    contact: bool  # something was touched with force


class Simulation:
    """The robot in the world of an outline. State: x, y, heading, velocity x, y, turn rate; world frame, SI units.

    The state of what moves beside it is in its `Movers`.
    """

    def __init__(self, outline: Outline, config: RobotConfig, movers: Movers | None = None) -> None:
        self.config = config
        self._segments = np.ascontiguousarray(outline.segments)
        self._state = np.zeros(6)
        self._state[:3] = outline.starts[0]
        self._limits, self._substeps = RobotLimits.of(config), config.arcs * config.substeps
        self._course = np.zeros(COURSE)
        self.admit(movers or no_movers(config))

    @property
    def T_world_robot(self) -> Array:
        """True pose (3,): x, y, heading in (-pi, pi]. A copy."""
        pose = self._state[:3].copy()
        pose[2] = wrap_angle(pose[2])
        return pose

    def reset(self, T_world_robot: Array) -> None:
        """Puts the robot at rest at a pose (3,), which is off the walls (`check_start`)."""
        self._state = np.concatenate([T_world_robot, np.zeros(3)])

    def step(self, v: float, w: float) -> Motion:
        """Drives one step with the commanded speed v (m/s) and turn rate w (rad/s), at most what the robot can do."""
        v_max, w_max = self.config.max_speed_m_s, self.config.max_turn_rad_s
        self._course[SPEED], self._course[TURN] = min(max(v, -v_max), v_max), min(max(w, -w_max), w_max)
        self._movers.decide(self._segments, self._state[:3], self._state[3:])
        increments, moving = np.empty((self.config.arcs, 2)), self._moving
        robot = self._segments, self._state, tuple(self._limits), self._course, increments, tuple(moving)
        done, contact = drive_on(*robot, 0)
        bodies = Bodies(self._segments, self.config, self._state, moving) if done < self._substeps else None
        while bodies and done < self._substeps:
            bodies.substep(self._state, self._course)
            done, touched = drive_on(*robot, done + 1)
            contact = contact or touched
        return Motion(increments, contact)

    def admit(self, movers: Movers) -> None:
        """Let other things move beside the robot than before; their arrays are shared."""
        self._movers, state = movers, movers.state
        robot = robot_row(self._state[:3], self._state[3:], self.config)
        others = state.pedestrians, state.boxes, state.sizes, movers.box_discs
        self._moving = MovingBodies(*others, robot, movers.config.polite)

    def get_state(self) -> dict[str, Any]:
        """The state as plain data."""
        return {"body": self._state.copy()}

    def set_state(self, state: dict[str, Any]) -> None:
        """Continues bit for bit from what `get_state` gave."""
        self._state = np.array(state["body"], np.float64)
