"""The robot among walls as pymunk alone moves it: the reference for the compiled motion."""

import numpy as np
import pymunk
from numpy.typing import NDArray

from mecp_env.world.config import RobotConfig
from mecp_env.world.drive import TOUCH_M, RobotLimits, leave_walls, wheels

Array = NDArray[np.float64]


class PymunkDrive:
    """Control steps from any state.

    Where several walls are touched at once, the ten iterations of pymunk's solver leave an error.
    """

    def __init__(self, segments: Array, config: RobotConfig) -> None:
        self.config, self.segments, self.limits = config, segments, RobotLimits.of(config)
        self.space = pymunk.Space()
        self.space.collision_slop, self.space.collision_bias, self.space.collision_persistence = 0.0, 1.0, 1
        walls = [pymunk.Segment(self.space.static_body, a, b, 0.0) for a, b in segments.tolist()]
        self.body = pymunk.Body(9.0, 9.0 * config.radius_m**2 / 2.0)
        self.space.add(*walls, self.body, pymunk.Circle(self.body, config.radius_m))
        self.most_contacts = 0  # at the same time, in the last step

    def step(self, state: Array, v: float, w: float) -> tuple[Array, bool]:
        """The state (6,) after a control step with a command, and whether a wall was touched."""
        state, touched = state.copy(), False
        self.most_contacts = 0
        for _ in range(self.config.arcs * self.config.substeps):
            aim = np.array(wheels(state, self.limits, v, w))
            velocity = self._substep(state, aim)
            touched |= bool(np.hypot(*(velocity - aim)[:2]) > 1e-6)
            state = np.concatenate([state[:3] + state[3:] * self.limits.dt, velocity])
            leave_walls(self.segments, state, self.config.radius_m - TOUCH_M)
        return state, touched

    def _substep(self, state: Array, aim: Array) -> Array:
        """(3,) the velocity and turn rate that walls leave of those that the wheels aim at."""
        x, y, angle, vx, vy, spin = state.tolist()
        body, dt = self.body, self.limits.dt
        body.position, body.angle, body.velocity, body.angular_velocity = (x, y), angle, (vx, vy), spin
        body.force = tuple(body.mass / dt * (aim[:2] - state[3:5]))
        body.torque = body.moment / dt * (aim[2] - spin)
        self.space.step(dt)
        contacts: list[pymunk.Arbiter] = []
        body.each_arbiter(contacts.append)
        self.most_contacts = max(self.most_contacts, len(contacts))
        return np.array([*body.velocity, body.angular_velocity])
