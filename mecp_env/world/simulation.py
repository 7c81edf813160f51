"""The physics: a circular differential-drive robot among walls, pedestrians and boxes.

One `step()` is one control step of many substeps. In each, the body first moves with its velocity, then the wheels set
a new one (towards the command, within the acceleration limits, without sideways motion), and contacts correct it. So
the velocity of a body in contact never points into the wall, and the little by which it enters a wall when it first
touches it is undone at once. One compiled function does all this (drive.py); while something that moves is within the
robot's reach, or a box slides, pymunk decides what the contacts do to the velocities (bodies.py). Only the six numbers
of the state, and the arrays of what moves, outlive a control step: a restored state continues bit for bit.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mecp_env.core.carriers import Array, carrier
from mecp_env.core.errors import ActionError, MecpError
from mecp_env.core.se2 import wrap_angle
from mecp_env.world.bodies import Bodies
from mecp_env.world.config import RobotConfig
from mecp_env.world.drive import (
    COURSE,
    SPEED,
    TOUCH_M,
    TURN,
    MovingBodies,
    RobotLimits,
    drive_on,
    wall_distance,
)
from mecp_env.world.moving_obstacles import Movers, no_movers, robot_row
from mecp_env.world.outline import Outline


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
        self._course[SPEED], self._course[TURN] = self._within_limits(v, w)
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
        """Continues bit for bit from what `get_state` gave. Raises MecpError for anything else."""
        body = np.array(state.get("body", ()), dtype=np.float64)
        if body.shape != (6,) or not np.isfinite(body).all():
            raise MecpError(f"body: expected six finite numbers, given {body!r}")
        self._state = body

    def _within_limits(self, v: float, w: float) -> tuple[float, float]:
        v_max, w_max = self.config.max_speed_m_s, self.config.max_turn_rad_s
        return min(max(v, -v_max), v_max), min(max(w, -w_max), w_max)
