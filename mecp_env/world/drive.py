"""Compiled motion of the robot and of boxes: wheels, walls, friction, and when pymunk has to resolve contacts."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from mecp_env.core.carriers import Array, Bools
from mecp_env.core.jit import compiled
from mecp_env.world.config import RobotConfig
from mecp_env.world.moving_obstacles import BOX_CORNERS
from mecp_env.world.pedestrians import PACE, RADIUS, X, Y, from_face, walk

TOUCH_M = 1e-3  # a body in contact stays this deep in the wall, or the next substep would not see the contact
SPARE_M = 0.05  # what is pushed may be a little faster than the robot drives
PUSHED_M_S = 1e-6  # a contact is what changes the velocity by more than this
ROUNDS = 50  # of leaving one wall after another; two are enough, but not in an acute corner
ROUNDING_M_S = 1e-12  # a velocity into a wall below this is a rounding error
DECELERATION = 1.5  # m/s^2, of a box that slides on felt
TURN_DECELERATION = 8.0  # rad/s^2
DEEPEST_M = 0.05  # what is deeper in a wall is behind it
BOX_ROUNDS = 4  # of moving a box out of one wall after another

# The course (11,), scratch memory of a control step: the command; the pose at the last reading; the velocity and turn
# rate that the wheels aim at in the substep that pymunk makes next; the velocity and turn rate that came of it
SPEED, TURN, ARC_X, ARC_Y, ARC_HEADING, AIM_X, AIM_Y, AIM_TURN, FELT_X, FELT_Y, FELT_TURN = range(11)
COURSE = 11


class RobotLimits(NamedTuple):
    """What the robot can do within a substep."""

    dt: float  # s
    max_dv: float  # m/s, change of speed by the wheels
    max_dw: float  # rad/s, change of turn rate by the wheels
    stride: float  # m, the longest distance
    radius: float  # m
    substeps: int  # per arc, of which odometry reads one increment

    @classmethod
    def of(cls, robot: RobotConfig) -> RobotLimits:
        """Those of a configured robot."""
        dt = robot.substep_s
        changes = robot.max_acceleration_m_s2 * dt, robot.max_turn_acceleration_rad_s2 * dt
        return cls(dt, *changes, robot.max_speed_m_s * dt, robot.radius_m, robot.substeps)


class MovingBodies(NamedTuple):
    """Pedestrians and boxes, and what they need to know of the robot."""

    pedestrians: Array  # (n,11), see pedestrians.py
    boxes: Array  # (b,6) m, rad: place, turn, and their velocities
    sizes: Array  # (b,2) m
    box_discs: Array  # (b,3) m: place and reach of the boxes
    robot: Array  # (6,), see pedestrians.py; written in every substep
    polite: bool  # the pedestrians avoid the robot


@compiled
def drive_on(
    segments: Array,
    state: Array,
    robot_limits: tuple[Any, ...],
    course: Array,
    increments: Array,
    moving: tuple[Any, ...],
    done: int,
) -> tuple[int, bool]:
    """Drive on from substep `done` of the control step; the substep reached, and whether something was touched.

    The substep reached is the last one, or the one before a substep that pymunk has to make because something that
    moves is within reach: `course` then holds the velocity that the wheels aim at, and, in the next call, the velocity
    that pymunk left. Updates the state (6,), the readings `increments` (M,2) of the arcs that end, and the pedestrians.
    `robot_limits` and `moving` are the fields of `RobotLimits` and `MovingBodies`: a plain tuple costs less in a call.
    """
    limits, obstacles = RobotLimits(*robot_limits), MovingBodies(*moving)
    touched, boxes, box_discs, robot = False, obstacles.boxes, obstacles.box_discs, obstacles.robot
    if done > 0:
        touched = math.hypot(course[FELT_X] - course[AIM_X], course[FELT_Y] - course[AIM_Y]) > PUSHED_M_S
        move(state, limits, course[FELT_X], course[FELT_Y], course[FELT_TURN])
        leave_boxes(boxes, obstacles.sizes, state, limits.radius - TOUCH_M)
    for i in range(boxes.shape[0]):
        box_discs[i, 0], box_discs[i, 1] = boxes[i, 0], boxes[i, 1]
    last = increments.shape[0] * limits.substeps
    reach = limits.radius + furthest(state, limits, last - done + 1)
    near = faces_within(segments, np.array([[state[0], state[1], reach]]))
    while True:
        leave_walls(near, state, limits.radius - TOUCH_M)
        if done % limits.substeps == 0:  # an arc ends: read the distance along its mean heading, and the turn
            if done > 0:
                turn = state[2] - course[ARC_HEADING]
                heading, arc = course[ARC_HEADING] + 0.5 * turn, done // limits.substeps - 1
                dx, dy = state[0] - course[ARC_X], state[1] - course[ARC_Y]
                increments[arc, 0], increments[arc, 1] = dx * math.cos(heading) + dy * math.sin(heading), turn
            course[ARC_X], course[ARC_Y], course[ARC_HEADING] = state[0], state[1], state[2]
        if done == last:
            break
        robot[0], robot[1], robot[2], robot[3] = state[0], state[1], state[3], state[4]
        walk(obstacles.pedestrians, box_discs, robot, obstacles.polite, limits.dt)
        vx, vy, w = wheels(state, limits, course[SPEED], course[TURN])
        if in_reach(obstacles, state, limits):
            course[AIM_X], course[AIM_Y], course[AIM_TURN] = vx, vy, w
            break
        free_x, free_y = slide(near, state, limits, vx, vy) if near.shape[0] else (vx, vy)
        touched = touched or math.hypot(free_x - vx, free_y - vy) > PUSHED_M_S
        move(state, limits, free_x, free_y, w)
        done += 1
    return done, touched


@compiled
def furthest(state: Array, limits: RobotLimits, substeps: int) -> float:
    """How far, m, the robot gets in some substeps, also where walls push it aside."""
    return 2.0 * substeps * max(limits.stride, math.hypot(state[3], state[4]) * limits.dt)


@compiled
def move(state: Array, limits: RobotLimits, vx: float, vy: float, w: float) -> None:
    """Move the state (6,) by a substep as pymunk does: with its velocity, which then becomes vx, vy, w."""
    state[0] += state[3] * limits.dt
    state[1] += state[4] * limits.dt
    state[2] += state[5] * limits.dt
    state[3], state[4], state[5] = vx, vy, w


@compiled
def wheels(state: Array, limits: RobotLimits, speed: float, turn: float) -> tuple[float, float, float]:
    """Velocity x, y and turn rate that the wheels aim at for the next substep: towards the command, within limits.

    A velocity has the direction that the robot has half-way through the substep in which it moves.
    """
    heading = state[2] + 0.5 * state[5] * limits.dt
    now = math.cos(heading) * state[3] + math.sin(heading) * state[4]
    v = now + min(max(speed - now, -limits.max_dv), limits.max_dv)
    w = state[5] + min(max(turn - state[5], -limits.max_dw), limits.max_dw)
    heading += 0.5 * (state[5] + w) * limits.dt
    return v * math.cos(heading), v * math.sin(heading), w


def wall_distance(segments: Array, x: float, y: float) -> float:
    """Distance from (x, y) to the nearest of the faces (S,2,2), m."""
    (ax, ay), (ux, uy) = segments[:, 0].T, (segments[:, 1] - segments[:, 0]).T
    share = np.clip(((x - ax) * ux + (y - ay) * uy) / (ux * ux + uy * uy), 0.0, 1.0)
    dx, dy = x - ax - share * ux, y - ay - share * uy
    return math.sqrt(float((dx * dx + dy * dy).min(initial=math.inf)))


@compiled
def faces_within(segments: Array, discs: Array) -> Array:
    """Those of the faces (S,2,2), in their order, that one of the discs (n,3) reaches: centre and radius, m."""
    near, n = np.empty_like(segments), 0
    for k in range(segments.shape[0]):
        reached = False
        for i in range(discs.shape[0]):
            dx, dy = from_face(segments, k, discs[i, 0], discs[i, 1])
            reached = reached or dx * dx + dy * dy < discs[i, 2] * discs[i, 2]
        if reached:
            for end in range(2):
                near[n, end, 0], near[n, end, 1] = segments[k, end, 0], segments[k, end, 1]
            n += 1
    return near[:n]


@compiled
def slide(near: Array, state: Array, limits: RobotLimits, vx: float, vy: float) -> tuple[float, float]:
    """The velocity nearest to vx, vy that leads into none of the walls that the robot touches after this substep.

    Walls are rigid and without friction: each takes the part of the velocity that leads into it. Where two are touched,
    this is the projection on the cone of the velocities that leave both, and does not depend on their order.
    """
    x, y = state[0] + state[3] * limits.dt, state[1] + state[4] * limits.dt
    normals, n = np.empty((near.shape[0], 2)), 0
    for k in range(near.shape[0]):
        dx, dy = from_face(near, k, x, y)
        distance = math.hypot(dx, dy)
        if 0.0 < distance < limits.radius:
            normals[n, 0], normals[n, 1] = dx / distance, dy / distance
            n += 1
    free_x, free_y, least = 0.0, 0.0, math.inf
    for i in range(-1, n):  # -1: the velocity itself, then its projection on each wall that it leads into
        along_x, along_y, push = vx, vy, 0.0
        if i >= 0:
            into = vx * normals[i, 0] + vy * normals[i, 1]
            along_x, along_y, push = vx - into * normals[i, 0], vy - into * normals[i, 1], -into
        if push >= least or push < 0.0:
            continue
        deepest = 0.0
        for j in range(n):
            deepest = min(deepest, along_x * normals[j, 0] + along_y * normals[j, 1])
        if deepest >= -ROUNDING_M_S:
            free_x, free_y, least = along_x, along_y, push
    return free_x, free_y


@compiled
def leave_walls(near: Array, state: Array, radius: float) -> None:
    """Move the robot's centre so that it is at least `radius` away from every wall."""
    for _ in range(ROUNDS):
        free = True
        for k in range(near.shape[0]):
            dx, dy = from_face(near, k, state[0], state[1])
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


@compiled
def in_reach(obstacles: MovingBodies, state: Array, limits: RobotLimits) -> bool:
    """True when a box slides, or a pedestrian or a box is within reach of the robot's next substep."""
    pedestrians, boxes, box_discs = obstacles.pedestrians, obstacles.boxes, obstacles.box_discs
    robot = limits.radius + TOUCH_M + limits.stride
    for i in range(pedestrians.shape[0]):
        reach = robot + pedestrians[i, RADIUS] + pedestrians[i, PACE] * limits.dt
        if math.hypot(pedestrians[i, X] - state[0], pedestrians[i, Y] - state[1]) < reach:
            return True
    for i in range(boxes.shape[0]):
        slides = boxes[i, 3] != 0.0 or boxes[i, 4] != 0.0 or boxes[i, 5] != 0.0
        near = math.hypot(box_discs[i, 0] - state[0], box_discs[i, 1] - state[1]) < robot + box_discs[i, 2]
        if slides or near:
            return True
    return False


def may_touch(obstacles: MovingBodies, state: Array, limits: RobotLimits, substeps: int) -> tuple[Bools, Bools]:
    """Which pedestrians (n,) and boxes (b,) may touch the robot, or a box that moves, within some substeps."""
    walkers, boxes, discs = obstacles.pedestrians, obstacles.boxes, obstacles.box_discs
    seconds, far = substeps * limits.dt, furthest(state, limits, substeps) + SPARE_M
    robot = np.array([*state[:2], limits.radius])
    speed = np.hypot(boxes[:, 3], boxes[:, 4])
    reach = discs[:, 2] + far + speed * seconds
    pushed = _within(boxes[:, :2], reach, robot[None])[:, 0] | (speed > 0.0) | (boxes[:, 5] != 0.0)
    beside = _within(boxes[:, :2], reach, discs)
    for _ in boxes:  # each may push another one
        pushed |= beside[:, pushed].any(axis=1)
    reach = walkers[:, RADIUS] + walkers[:, PACE] * seconds + far
    met: Bools = np.logical_or.reduce(_within(walkers[:, [X, Y]], reach, np.vstack([robot, discs[pushed]])), axis=1)
    return met, pushed


def _within(places: Array, reach: Array, discs: Array) -> Bools:
    """(n,m) which discs (m,3) are within reach (n,) of places (n,2)."""
    apart = np.hypot(*(places[:, None] - discs[:, :2]).transpose(2, 0, 1))
    near: Bools = apart < reach[:, None] + discs[:, 2]
    return near


@compiled
def slide_boxes(segments: Array, boxes: Array, sizes: Array, dt: float) -> None:
    """The floor slows the boxes (b,6) down for a substep, and the faces (S,2,2) that they entered push them out.

    A box leaves a face that it entered by at most `DEEPEST_M`.
    """
    for i in range(boxes.shape[0]):
        speed, turn = math.hypot(boxes[i, 3], boxes[i, 4]), abs(boxes[i, 5])
        share = max(1.0 - DECELERATION * dt / max(speed, 1e-9), 0.0)
        boxes[i, 3], boxes[i, 4] = share * boxes[i, 3], share * boxes[i, 4]
        boxes[i, 5] *= max(1.0 - TURN_DECELERATION * dt / max(turn, 1e-9), 0.0)
    for _ in range(BOX_ROUNDS):
        for i in range(boxes.shape[0]):
            for k in range(segments.shape[0]):
                _leave_face(segments[k], boxes[i], sizes[i])


@compiled
def _leave_face(face: Array, box: Array, size: Array) -> None:
    """Move the box (6,) until none of its corners is behind the face (2,2) and the face does not start in it."""
    reach = 0.5 * math.hypot(size[0], size[1])
    low_x, high_x = min(face[0, 0], face[1, 0]) - reach, max(face[0, 0], face[1, 0]) + reach
    low_y, high_y = min(face[0, 1], face[1, 1]) - reach, max(face[0, 1], face[1, 1]) + reach
    if not (low_x < box[0] < high_x and low_y < box[1] < high_y):
        return
    ux, uy = face[1, 0] - face[0, 0], face[1, 1] - face[0, 1]
    length = math.hypot(ux, uy)
    c, s = math.cos(box[2]), math.sin(box[2])
    for corner in range(4):
        along, aside = BOX_CORNERS[corner, 0] * size[0], BOX_CORNERS[corner, 1] * size[1]
        x, y = box[0] + c * along - s * aside, box[1] + s * along + c * aside
        ahead = ((x - face[0, 0]) * ux + (y - face[0, 1]) * uy) / length
        behind = ((y - face[0, 1]) * ux - (x - face[0, 0]) * uy) / -length
        if 0.0 < ahead < length and 0.0 < behind < DEEPEST_M:
            box[0] -= behind * uy / length
            box[1] += behind * ux / length
    dx, dy = face[0, 0] - box[0], face[0, 1] - box[1]
    along, aside = c * dx + s * dy, c * dy - s * dx
    deep_along, deep_aside = 0.5 * size[0] - abs(along), 0.5 * size[1] - abs(aside)
    if min(deep_along, deep_aside) <= 0.0 or min(deep_along, deep_aside) >= DEEPEST_M:
        return
    if deep_along < deep_aside:
        push = -math.copysign(deep_along, along)
        box[0] += push * c
        box[1] += push * s
    else:
        push = -math.copysign(deep_aside, aside)
        box[0] -= push * s
        box[1] += push * c


@compiled
def leave_boxes(boxes: Array, sizes: Array, state: Array, radius: float) -> None:
    """Push the robot's position out of boxes nearer than `radius`."""
    for i in range(boxes.shape[0]):
        c, s = math.cos(boxes[i, 2]), math.sin(boxes[i, 2])
        dx, dy = state[0] - boxes[i, 0], state[1] - boxes[i, 1]
        along, aside = c * dx + s * dy, c * dy - s * dx
        near_along = min(max(along, -0.5 * sizes[i, 0]), 0.5 * sizes[i, 0])
        near_aside = min(max(aside, -0.5 * sizes[i, 1]), 0.5 * sizes[i, 1])
        off_along, off_aside = along - near_along, aside - near_aside
        distance = math.hypot(off_along, off_aside)
        if 1e-9 < distance < radius - 1e-9:
            push = radius / distance - 1.0
            state[0] += push * (c * off_along - s * off_aside)
            state[1] += push * (s * off_along + c * off_aside)
