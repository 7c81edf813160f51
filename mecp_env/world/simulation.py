"""The physics: a circular differential-drive robot among walls, people and boxes, in a pymunk space.

One `step()` is one control step. Away from all those a compiled kernel moves the robot; within a substep's reach of
one, and while a box slides, pymunk does, in the same substeps and by the same scheme. In each substep the body first
moves with its velocity, then the wheels set a new one (towards the command, within the acceleration limits, and with no
motion sideways) and contacts correct it. So the velocity of a body in contact never points into the wall, and what
little it enters a wall when it first touches one is pushed out again. Nothing but the six numbers of the state, and the
arrays of what moves, outlives an arc: a restored state continues bit for bit.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pymunk
from numpy.typing import NDArray

from mecp_env.core.errors import ActionError, MecpError
from mecp_env.core.se2 import wrap_angle
from mecp_env.world.bodies import Bodies
from mecp_env.world.config import RobotConfig
from mecp_env.world.drive import (
    FELT_X,
    FORCE_X,
    SPEED,
    TOUCH_M,
    TURN,
    TWIST,
    DynamicObstacles,
    drive_among,
    drive_on,
    wall_distance,
    who_is_near,
)
from mecp_env.world.moving_obstacles import Movers, no_movers, robot_row
from mecp_env.world.outline import Outline

Array = NDArray[np.float64]

MASS_KG = 9.0  # Pioneer P3-DX


@dataclass(frozen=True, slots=True, eq=False)
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
        self._movers = movers or no_movers(config)
        self._segments = np.ascontiguousarray(outline.segments)
        self._state = np.zeros(6)
        self._state[:3] = outline.starts[0]
        self._build()

    @property
    def T_world_robot(self) -> Array:
        """True pose (3,): x, y, heading in (-pi, pi]. A copy."""
        pose = self._state[:3].copy()
        pose[2] = wrap_angle(pose[2])
        return pose

    @property
    def velocity(self) -> Array:
        """True velocity (3,): x, y in the world frame, m/s; turn rate, rad/s. A copy."""
        return self._state[3:].copy()

    def reset(self, T_world_robot: Array) -> None:
        """Puts the robot at rest at a pose (3,). Raises MecpError for one that is not finite or reaches into a wall."""
        pose = np.array(T_world_robot, dtype=np.float64)
        if pose.shape != (3,) or not np.isfinite(pose).all():
            raise MecpError(f"T_world_robot: expected three finite numbers, given {T_world_robot!r}")
        room = wall_distance(self._segments, pose[0], pose[1])
        if room < self.config.radius_m - TOUCH_M:
            raise MecpError(f"T_world_robot: {pose} is {room:.3f} m from a wall, at least {self.config.radius_m} m")
        self._state = np.concatenate([pose, np.zeros(3)])

    def step(self, v: float, w: float) -> Motion:
        """Drives one step with the commanded speed v (m/s) and turn rate w (rad/s), limited to what the robot can do.

        Raises ActionError for a command that is not finite; the robot is then where it was.
        """
        if not (math.isfinite(v) and math.isfinite(w)):
            raise ActionError(f"command: v={v!r}, w={w!r}, expected finite numbers")
        self._drive[SPEED], self._drive[TURN] = self._within_limits(v, w)
        self._movers.decide(self._segments, self._state[:3], self._state[3:])
        increments, contact = np.empty((self.config.arcs, 2)), False
        done, _, _ = self._drive_on(increments, 0)
        glided = stale = True
        while done < self._substeps:
            self._substep_in_pymunk(stale, forget=glided or done % self.config.substeps == 0)
            reached, touched, stale = self._drive_on(increments, done + 1)
            glided = reached > done + 1
            contact |= touched
            done = reached
        return Motion(increments, contact)

    def admit(self, movers: Movers) -> None:
        """Let other things move beside the robot than before."""
        if len(movers) or len(self._movers):
            self._movers = movers
            self._build()

    def get_state(self) -> dict[str, Any]:
        """The state as plain data."""
        return {"body": self._state.copy()}

    def set_state(self, state: dict[str, Any]) -> None:
        """Continues bit for bit from what `get_state` gave. Raises MecpError for anything else."""
        body = np.array(state.get("body", ()), dtype=np.float64)
        if body.shape != (6,) or not np.isfinite(body).all():
            raise MecpError(f"body: expected six finite numbers, given {body!r}")
        self._state = body

    def __getstate__(self) -> dict[str, Any]:
        return {"config": self.config, "segments": self._segments, "body": self._state, "movers": self._movers}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.config, self._movers = state["config"], copy.deepcopy(state["movers"])
        self._segments, self._state = state["segments"].copy(), state["body"].copy()
        self._build()

    def _build(self) -> None:
        """What is worked out once of config and outline, the pymunk space among it; nothing that the state holds."""
        config, dt = self.config, self.config.substep_s
        moment, stride = MASS_KG * config.radius_m**2 / 2.0, config.max_speed_m_s * dt
        changes = config.max_acceleration_m_s2 * dt, config.max_turn_acceleration_rad_s2 * dt
        distances = stride, config.radius_m + TOUCH_M + stride, config.radius_m - TOUCH_M
        self._drive = np.array([0.0, 0.0, *changes, dt, MASS_KG / dt, moment / dt, *distances, config.substeps])
        self._course = np.zeros(11)
        self._push, self._felt = self._course[FORCE_X : TWIST + 1], self._course[FELT_X:]
        self._substeps, self._substep_s = config.arcs * config.substeps, dt
        self._space = pymunk.Space()
        self._space.collision_slop = 0.0
        self._space.collision_bias = 1.0  # off: pymunk keeps its way out of a wall where no state sees it
        self._space.collision_persistence = 1  # 0 switches contacts off
        for a, b in self._segments.tolist():
            self._space.add(pymunk.Segment(self._space.static_body, a, b, 0.0))
        self._body = pymunk.Body(MASS_KG, moment)
        self._shape = pymunk.Circle(self._body, config.radius_m)  # frictionless: it slides along walls
        self._space.add(self._body, self._shape)
        self._bodies = Bodies(self._space, self._movers.state) if len(self._movers) else None
        self._rounds, self._robot = self._movers.round_boxes(), robot_row(self._state[:3], self._state[3:], config)

    def _within_limits(self, v: float, w: float) -> tuple[float, float]:
        v_max, w_max = self.config.max_speed_m_s, self.config.max_turn_rad_s
        return min(max(v, -v_max), v_max), min(max(w, -w_max), w_max)

    def _drive_on(self, increments: Array, done: int) -> tuple[int, bool, bool]:
        """As the kernel `drive_on` or `drive_among`, for the robot as it is."""
        robot = self._segments, self._state, self._drive, self._course, increments
        if not self._bodies:
            return drive_on(*robot, done)
        return drive_among(*robot, self._obstacles(), self._movers.config.polite, done)

    def _obstacles(self) -> DynamicObstacles:
        """People and boxes, as the kernels take them."""
        moving = self._movers.state
        return moving.people, moving.boxes, moving.sizes, self._rounds, self._robot

    def _substep_in_pymunk(self, stale: bool, forget: bool) -> None:
        """One substep in pymunk, which does not have the state yet if `stale`, and may be told to `forget` contacts.

        Only the velocity that comes of it is asked for: the pose follows from the velocities (see `move`).
        """
        body = self._body
        if stale:
            x, y, body.angle, vx, vy, body.angular_velocity = self._state.tolist()
            body.position, body.velocity = (x, y), (vx, vy)
        if forget:  # a shape that was taken out and in has no past
            self._space.remove(self._shape)
            self._space.add(self._shape)
        if self._bodies:
            near = who_is_near(self._obstacles(), self._state, self._drive)
            self._bodies.enter(near.tolist(), self._substep_s, forget)
        force_x, force_y, torque = self._push.tolist()
        body.force = force_x, force_y
        if torque:  # pymunk has none after a substep
            body.torque = torque
        self._space.step(self._substep_s)
        self._felt[:] = *body.velocity, body.angular_velocity
        if self._bodies:
            self._bodies.leave(self._segments, self._substep_s)
