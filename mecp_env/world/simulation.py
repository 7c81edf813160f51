"""The physics: a circular differential-drive robot among static walls, in a pymunk space.

One `step()` is one control period. Away from walls a compiled kernel moves the robot; within a substep's reach of one,
pymunk does, in the same substeps and by the same scheme. In each substep the body first moves with its velocity, then
the wheels set a new one (towards the command, within the acceleration limits, and with no motion sideways) and contacts
correct it. So the velocity of a body in contact never points into the wall, and what little it enters a wall when it
first touches one is pushed out again. Nothing but the six numbers of the state outlives an arc: a restored state
continues bit for bit.
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
    """What the body truly did in one period, arc by arc; while it turns faster and faster, an arc leaves 0.1 mm out."""

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
        increments, contact = np.empty((self.config.arcs, 2)), False
        for arc in range(self.config.arcs):
            before = self._state.copy()
            contact |= self._arc(command)
            increments[arc] = increment(before, self._state)
        return Motion(increments, contact)

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
        return {"config": self.config, "segments": self._segments, "body": self._state}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.config = state["config"]
        self._segments, self._state = state["segments"].copy(), state["body"].copy()
        self._build()

    def _build(self) -> None:
        """The pymunk space of the outline; it holds nothing that the state does not."""
        config, dt = self.config, self.config.substep_s
        moment = MASS_KG * config.radius_m**2 / 2.0
        changes = config.max_acceleration_m_s2 * dt, config.max_turn_acceleration_rad_s2 * dt
        self._drive = np.array([*changes, dt, MASS_KG / dt, moment / dt])
        self._stride_m = config.max_speed_m_s * dt
        self._space = pymunk.Space()
        self._space.collision_slop = 0.0
        self._space.collision_bias = 1.0  # off: pymunk keeps its way out of a wall where no state sees it
        self._space.collision_persistence = 1  # 0 switches contacts off
        for a, b in self._segments.tolist():
            self._space.add(pymunk.Segment(self._space.static_body, a, b, 0.0))
        self._body = pymunk.Body(MASS_KG, moment)
        self._shape = pymunk.Circle(self._body, config.radius_m)  # frictionless: it slides along walls
        self._space.add(self._body, self._shape)

    def _within_limits(self, v: float, w: float) -> Array:
        v_max, w_max = self.config.max_speed_m_s, self.config.max_turn_rad_s
        return np.array([min(max(v, -v_max), v_max), min(max(w, -w_max), w_max)])

    def _arc(self, command: Array) -> bool:
        """Moves by one arc; returns whether something was touched with force."""
        reach = self.config.radius_m + TOUCH_M + self._stride_m
        contact, fresh, left = False, True, self.config.substeps
        while left:
            free = glide(self._segments, self._state, command, self._drive, left, reach, self._stride_m)
            left -= free
            if left:
                contact |= self._substep_near_wall(command, fresh or free > 0)
                fresh, left = False, left - 1
        return contact

    def _load_body(self) -> None:
        """Gives pymunk the state; then takes its shape out and in, so that no past contact is remembered."""
        x, y, heading, vx, vy, w = self._state.tolist()
        self._body.position, self._body.angle = (x, y), heading
        self._body.velocity, self._body.angular_velocity = (vx, vy), w
        self._space.remove(self._shape)
        self._space.add(self._shape)

    def _substep_near_wall(self, command: Array, fresh: bool) -> bool:
        """Moves by one substep in pymunk, which has the state already unless `fresh`."""
        if fresh:
            self._load_body()
        body = self._body
        vx, vy, w = wheels(self._state, command, self._drive)
        body.force, body.torque = wheel_force(self._state, vx, vy, w, self._drive)
        self._space.step(self.config.substep_s)
        (x, y), (x_rate, y_rate) = body.position, body.velocity
        settled = settle(self._segments, self._state, x, y, self.config.radius_m - TOUCH_M)
        self._state[2:] = body.angle, x_rate, y_rate, body.angular_velocity
        if not settled:
            body.position = self._state[0], self._state[1]
        return math.hypot(x_rate - vx, y_rate - vy) > PUSHED_M_S


@kernel
def increment(before: Array, after: Array) -> tuple[float, float]:
    """Distance along the mean heading, and turn, from one state (6,) to another."""
    turn = after[2] - before[2]
    heading = before[2] + 0.5 * turn
    return (after[0] - before[0]) * math.cos(heading) + (after[1] - before[1]) * math.sin(heading), turn


@kernel
def wheels(state: Array, command: Array, drive: Array) -> tuple[float, float, float]:
    """Velocity x, y and turn rate that the wheels aim at for the next substep.

    From the present speed towards the command (2,), by at most drive[0] and drive[1]. A velocity has the direction
    that the robot has half-way through the substep in which it moves; substeps last drive[2] seconds.
    """
    heading = state[2] + 0.5 * state[5] * drive[2]
    speed = math.cos(heading) * state[3] + math.sin(heading) * state[4]
    v = speed + min(max(command[0] - speed, -drive[0]), drive[0])
    w = state[5] + min(max(command[1] - state[5], -drive[1]), drive[1])
    heading += 0.5 * (state[5] + w) * drive[2]
    return v * math.cos(heading), v * math.sin(heading), w


@kernel
def wheel_force(state: Array, vx: float, vy: float, w: float, drive: Array) -> tuple[tuple[float, float], float]:
    """Force and torque that give the body of the state (6,) the velocity vx, vy, w within a substep."""
    return ((vx - state[3]) * drive[3], (vy - state[4]) * drive[3]), (w - state[5]) * drive[4]


@kernel
def glide(
    segments: Array, state: Array, command: Array, drive: Array, substeps: int, reach: float, stride: float
) -> int:
    """Moves the state (6,) while no wall is within `reach`, as pymunk would; returns how many substeps were made."""
    spare = wall_distance(segments, state[0], state[1]) - reach
    for done in range(substeps):
        if spare <= 0.0:
            spare = wall_distance(segments, state[0], state[1]) - reach
        if spare <= 0.0:
            return done
        spare -= stride
        vx, vy, w = wheels(state, command, drive)
        state[0] += state[3] * drive[2]
        state[1] += state[4] * drive[2]
        state[2] += state[5] * drive[2]
        state[3], state[4], state[5] = vx, vy, w
    return substeps


@kernel
def wall_distance(segments: Array, x: float, y: float) -> float:
    """Distance from (x, y) to the nearest of the faces (S,2,2), m."""
    nearest = math.inf
    for k in range(segments.shape[0]):
        dx, dy = _from_face(segments, k, x, y)
        nearest = min(nearest, dx * dx + dy * dy)
    return math.sqrt(nearest)


@kernel
def settle(segments: Array, state: Array, x: float, y: float, radius: float) -> bool:
    """Puts the state's position at (x, y), out of all walls nearer than `radius`; returns whether (x, y) was free."""
    state[0], state[1] = x, y
    for _ in range(8):
        free = True
        for k in range(segments.shape[0]):
            dx, dy = _from_face(segments, k, state[0], state[1])
            distance = math.sqrt(dx * dx + dy * dy)
            if 1e-9 < distance < radius - 1e-9:
                state[0] += dx * (radius / distance - 1.0)
                state[1] += dy * (radius / distance - 1.0)
                free = False
        if free:
            break
    return bool(state[0] == x and state[1] == y)


@kernel
def _from_face(segments: Array, k: int, x: float, y: float) -> tuple[float, float]:
    """Vector to (x, y) from the nearest point of face k."""
    ax, ay = segments[k, 0, 0], segments[k, 0, 1]
    ux, uy = segments[k, 1, 0] - ax, segments[k, 1, 1] - ay
    share = min(max(((x - ax) * ux + (y - ay) * uy) / (ux * ux + uy * uy), 0.0), 1.0)
    return x - ax - share * ux, y - ay - share * uy
