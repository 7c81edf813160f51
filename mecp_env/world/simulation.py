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

# The drive (11,): the command; how much the wheels change their speeds in a substep; how long one is; force and torque
# that change a velocity by one in it; how far the robot gets in it; how near a wall pymunk moves the robot, and where
# that is pushed out of it; how many substeps an arc has
SPEED, TURN, MOST_DV, MOST_DW, DT, FORCE, TORQUE, STRIDE, REACH, INNER, SUBSTEPS = range(11)
# The course (11,): the pose at the last reading; for the substep that pymunk makes next, the velocity that the wheels
# aim at, and the force and the torque for it; the velocity x, y and the turn rate that came of it
AIM_X, AIM_Y, FORCE_X, FORCE_Y, TWIST, FELT_X, FELT_Y, FELT_TURN = range(3, 11)


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
        self._drive[SPEED], self._drive[TURN] = self._within_limits(v, w)
        increments, contact = np.empty((self.config.arcs, 2)), False
        robot = self._segments, self._state, self._drive, self._course, increments
        done, _, _ = drive_on(*robot, 0)
        glided = stale = True
        while done < self._substeps:
            self._substep_in_pymunk(stale, forget=glided or done % self.config.substeps == 0)
            reached, touched, stale = drive_on(*robot, done + 1)
            glided = reached > done + 1
            contact |= touched
            done = reached
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

    def _within_limits(self, v: float, w: float) -> tuple[float, float]:
        v_max, w_max = self.config.max_speed_m_s, self.config.max_turn_rad_s
        return min(max(v, -v_max), v_max), min(max(w, -w_max), w_max)

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
        force_x, force_y, torque = self._push.tolist()
        body.force = force_x, force_y
        if torque:  # pymunk has none after a substep
            body.torque = torque
        self._space.step(self._substep_s)
        self._felt[:] = *body.velocity, body.angular_velocity


@kernel
def drive_on(
    segments: Array, state: Array, drive: Array, course: Array, increments: Array, done: int
) -> tuple[int, bool, bool]:
    """Takes the state (6,) over after substep `done` of the period, at its start or from pymunk, and drives on.

    Returns the substep reached: the last, or one that pymunk must make, for a wall is within reach (see `course`);
    whether pymunk's substep touched something with force; whether pymunk does not have the state that was reached.
    """
    touched, settled = False, True
    if done > 0:
        touched = math.hypot(course[FELT_X] - course[AIM_X], course[FELT_Y] - course[AIM_Y]) > PUSHED_M_S
        move(state, drive, course[FELT_X], course[FELT_Y], course[FELT_TURN])
        settled = settle(segments, state, drive[INNER])
    reached = glide(segments, state, drive, course, increments, done)
    return reached, touched, reached > done or not settled


@kernel
def glide(segments: Array, state: Array, drive: Array, course: Array, increments: Array, done: int) -> int:
    """Moves the state (6,) while no wall is within reach, as pymunk would; returns the substep of the period reached.

    Arcs that end on the way are read into `increments` (M,2).
    """
    substeps, spare = int(drive[SUBSTEPS]), 0.0
    read_arc(state, course, increments, done, substeps)
    while done < increments.shape[0] * substeps:
        if spare <= 0.0 or done % substeps == 0:
            spare = wall_distance(segments, state[0], state[1]) - drive[REACH]
        vx, vy, w = wheels(state, drive)
        if spare <= 0.0:
            aim(state, drive, course, vx, vy, w)
            return done
        spare -= drive[STRIDE]
        move(state, drive, vx, vy, w)
        done += 1
        read_arc(state, course, increments, done, substeps)
    return done


@kernel
def move(state: Array, drive: Array, vx: float, vy: float, w: float) -> None:
    """Moves the state (6,) by a substep as pymunk does: with its velocity, which then becomes vx, vy, w."""
    state[0] += state[3] * drive[DT]
    state[1] += state[4] * drive[DT]
    state[2] += state[5] * drive[DT]
    state[3], state[4], state[5] = vx, vy, w


@kernel
def read_arc(state: Array, course: Array, increments: Array, done: int, substeps: int) -> None:
    """Reads off, where an arc ends, the distance along its mean heading and the turn; there the next one begins."""
    if done % substeps:
        return
    if done > 0:
        turn = state[2] - course[2]
        heading = course[2] + 0.5 * turn
        ahead = (state[0] - course[0]) * math.cos(heading) + (state[1] - course[1]) * math.sin(heading)
        increments[done // substeps - 1, 0], increments[done // substeps - 1, 1] = ahead, turn
    course[0], course[1], course[2] = state[0], state[1], state[2]


@kernel
def aim(state: Array, drive: Array, course: Array, vx: float, vy: float, w: float) -> None:
    """Notes the velocity that the wheels aim at, and the force and torque that give it to the body in a substep."""
    course[AIM_X], course[AIM_Y] = vx, vy
    course[FORCE_X] = (vx - state[3]) * drive[FORCE]
    course[FORCE_Y] = (vy - state[4]) * drive[FORCE]
    course[TWIST] = (w - state[5]) * drive[TORQUE]


@kernel
def wheels(state: Array, drive: Array) -> tuple[float, float, float]:
    """Velocity x, y and turn rate that the wheels aim at for the next substep: towards the command, within limits.

    A velocity has the direction that the robot has half-way through the substep in which it moves.
    """
    heading = state[2] + 0.5 * state[5] * drive[DT]
    speed = math.cos(heading) * state[3] + math.sin(heading) * state[4]
    v = speed + min(max(drive[SPEED] - speed, -drive[MOST_DV]), drive[MOST_DV])
    w = state[5] + min(max(drive[TURN] - state[5], -drive[MOST_DW]), drive[MOST_DW])
    heading += 0.5 * (state[5] + w) * drive[DT]
    return v * math.cos(heading), v * math.sin(heading), w


@kernel
def wall_distance(segments: Array, x: float, y: float) -> float:
    """Distance from (x, y) to the nearest of the faces (S,2,2), m."""
    nearest = math.inf
    for k in range(segments.shape[0]):
        dx, dy = _from_face(segments, k, x, y)
        nearest = min(nearest, dx * dx + dy * dy)
    return math.sqrt(nearest)


@kernel
def settle(segments: Array, state: Array, radius: float) -> bool:
    """Pushes the state's position out of all walls nearer than `radius`; returns whether there was none."""
    x, y = state[0], state[1]
    for _ in range(8):
        free = True
        for k in range(segments.shape[0]):
            dx, dy = _from_face(segments, k, state[0], state[1])
            squared = dx * dx + dy * dy
            if squared > radius * radius:
                continue
            distance = math.sqrt(squared)
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
