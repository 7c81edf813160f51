"""The physics: a circular differential-drive robot among static walls, in a pymunk space.

One `step()` is one control period. Far from every wall a compiled kernel moves the robot; near one, pymunk does, in the
same substeps and by the same scheme. In each substep the body first moves with its velocity, then the wheels set a new
one (towards the command, within the acceleration limits, and with no motion sideways) and contacts correct it. So the
velocity of a body in contact never points into the wall, and what little it enters a wall when it first touches one is
pushed out again. Nothing but the six numbers of the state outlives an arc: a restored state continues bit for bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pymunk
from numpy.typing import NDArray

from mecp_env.errors import ActionError, MecpError
from mecp_env.kernel import kernel
from mecp_env.slam.geometry import wrap_angle
from mecp_env.world.config import RobotConfig
from mecp_env.world.outline import Outline

Array = NDArray[np.float64]

MASS_KG = 9.0  # Pioneer P3-DX
TOUCH_M = 1e-3  # a body in contact stays so far inside the wall, or the next substep would not see the contact
PUSHED_M_S = 1e-6  # a contact is what changes the velocity by more than this


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """What the body truly did in one period, arc by arc."""

    increments: Array  # (M,2) m, rad: signed distance along the mean heading of the arc, turn
    contact: bool  # something was touched with force


class Simulation:
    """The robot in the world of an outline. State: x, y, heading, velocity x, y, turn rate; world frame, SI units."""

    def __init__(self, outline: Outline, config: RobotConfig) -> None:
        self.config = config
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
        """Drives one period with the commanded speed v (m/s) and turn rate w (rad/s), limited to what the robot can do.

        Raises ActionError for a command that is not finite; the robot is then where it was.
        """
        if not (math.isfinite(v) and math.isfinite(w)):
            raise ActionError(f"command: v={v!r}, w={w!r}, expected finite numbers")
        command = self._within_limits(v, w)
        reach = self.config.radius_m + TOUCH_M + self.config.max_speed_m_s * self._arc_s
        increments, contact = np.empty((self.config.arcs, 2)), False
        for arc in range(self.config.arcs):
            before = self._state.copy()
            if wall_distance(self._segments, before[0], before[1]) > reach:
                glide(self._state, command, self._limits, self.config.substeps)
            else:
                contact |= self._arc_near_wall(command)
            increments[arc] = self._increment(before)
        return Motion(increments, contact)

    def get_state(self) -> dict[str, Any]:
        """The state as plain data."""
        return {"body": self._state.copy()}

    def set_state(self, state: dict[str, Any]) -> None:
        """Continues bit for bit from what `get_state` gave."""
        body = np.array(state["body"], dtype=np.float64)
        if body.shape != (6,) or not np.isfinite(body).all():
            raise MecpError(f"body: expected six finite numbers, given {state['body']!r}")
        self._state = body

    def __getstate__(self) -> dict[str, Any]:
        return {"config": self.config, "segments": self._segments, "body": self._state}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.config = state["config"]
        self._segments, self._state = state["segments"].copy(), state["body"].copy()
        self._build()

    def _build(self) -> None:
        """The pymunk space of the outline; it holds nothing that the state does not."""
        config = self.config
        self._arc_s = config.period_s / config.arcs
        dt = config.substep_s
        self._limits = np.array([config.max_acceleration_m_s2 * dt, config.max_turn_acceleration_rad_s2 * dt, dt])
        self._space = pymunk.Space()
        self._space.collision_slop = 0.0
        self._space.collision_bias = 1.0  # off: pymunk's own way out of a wall lives on in the body, where no state sees it
        self._space.collision_persistence = 1  # 0 would switch contacts off altogether
        for a, b in self._segments.tolist():
            self._space.add(pymunk.Segment(self._space.static_body, a, b, 0.0))
        self._body = pymunk.Body(MASS_KG, MASS_KG * config.radius_m**2 / 2.0)
        self._shape = pymunk.Circle(self._body, config.radius_m)  # frictionless: it slides along walls
        self._space.add(self._body, self._shape)

    def _within_limits(self, v: float, w: float) -> Array:
        v_max, w_max = self.config.max_speed_m_s, self.config.max_turn_rad_s
        return np.array([min(max(v, -v_max), v_max), min(max(w, -w_max), w_max)])

    def _arc_near_wall(self, command: Array) -> bool:
        """Moves by one arc in pymunk; returns whether something was touched with force."""
        body, state = self._body, self._state
        self._forget_contacts()
        body.position, body.angle = (state[0], state[1]), state[2]
        body.velocity, body.angular_velocity = (state[3], state[4]), state[5]
        contact = False
        for _ in range(self.config.substeps):
            contact |= self._substep(command)
        return contact

    def _forget_contacts(self) -> None:
        """Takes the robot's shape out and in again: the arc starts without what pymunk remembers of the last one."""
        self._space.remove(self._shape)
        self._space.add(self._shape)

    def _substep(self, command: Array) -> bool:
        body, state, dt = self._body, self._state, self.config.substep_s
        wanted = wheels(state, command, self._limits)
        body.force = (MASS_KG * (wanted[0] - state[3]) / dt, MASS_KG * (wanted[1] - state[4]) / dt)
        body.torque = body.moment * (wanted[2] - state[5]) / dt
        self._space.step(dt)
        state[0], state[1] = body.position
        state[2] = body.angle
        state[3], state[4] = body.velocity
        state[5] = body.angular_velocity
        if push_out(self._segments, state, self.config.radius_m - TOUCH_M):
            body.position = (state[0], state[1])
        return math.hypot(state[3] - wanted[0], state[4] - wanted[1]) > PUSHED_M_S

    def _increment(self, before: Array) -> tuple[float, float]:
        """Distance along the mean heading, and turn, since the state `before`."""
        turn = self._state[2] - before[2]
        mean_heading = before[2] + 0.5 * turn
        moved = self._state[:2] - before[:2]
        return moved[0] * math.cos(mean_heading) + moved[1] * math.sin(mean_heading), turn


@kernel
def wheels(state: Array, command: Array, limits: Array) -> Array:
    """Velocity (3,) that the wheels aim at for the next substep: x, y, turn rate.

    From the speed along the heading towards the command (2,), by at most limits[0] and limits[1]; in the direction
    that the robot will have half-way through the next substep, which begins when this one of limits[2] seconds ends.
    """
    heading = state[2] + state[5] * limits[2]
    speed = math.cos(state[2]) * state[3] + math.sin(state[2]) * state[4]
    v = speed + min(max(command[0] - speed, -limits[0]), limits[0])
    w = state[5] + min(max(command[1] - state[5], -limits[1]), limits[1])
    heading += 0.5 * w * limits[2]
    wanted = np.empty(3)
    wanted[0], wanted[1], wanted[2] = v * math.cos(heading), v * math.sin(heading), w
    return wanted


@kernel
def glide(state: Array, command: Array, limits: Array, substeps: int) -> None:
    """Moves the state (6,) by an arc where nothing can be touched, as pymunk would."""
    for _ in range(substeps):
        wanted = wheels(state, command, limits)
        state[0] += state[3] * limits[2]
        state[1] += state[4] * limits[2]
        state[2] += state[5] * limits[2]
        state[3], state[4], state[5] = wanted[0], wanted[1], wanted[2]


@kernel
def wall_distance(segments: Array, x: float, y: float) -> float:
    """Distance from (x, y) to the nearest of the faces (S,2,2), m."""
    nearest = math.inf
    for k in range(segments.shape[0]):
        dx, dy = _from_face(segments[k], x, y)
        nearest = min(nearest, dx * dx + dy * dy)
    return math.sqrt(nearest)


@kernel
def push_out(segments: Array, state: Array, radius: float) -> bool:
    """Moves the position of the state (6,) out of all walls nearer than `radius`; returns whether it moved."""
    moved = False
    for _ in range(8):
        settled = True
        for k in range(segments.shape[0]):
            dx, dy = _from_face(segments[k], state[0], state[1])
            distance = math.sqrt(dx * dx + dy * dy)
            if 1e-9 < distance < radius - 1e-9:
                state[0] += dx * (radius / distance - 1.0)
                state[1] += dy * (radius / distance - 1.0)
                settled, moved = False, True
        if settled:
            break
    return moved


@kernel
def _from_face(face: Array, x: float, y: float) -> tuple[float, float]:
    """Vector to (x, y) from the nearest point of the face (2,2)."""
    ux, uy = face[1, 0] - face[0, 0], face[1, 1] - face[0, 1]
    px, py = x - face[0, 0], y - face[0, 1]
    share = min(max((px * ux + py * uy) / (ux * ux + uy * uy), 0.0), 1.0)
    return px - share * ux, py - share * uy
