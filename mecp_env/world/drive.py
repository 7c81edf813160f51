"""Kernels of the drive: the robot away from all it could touch, as pymunk would move it, and out of walls."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.world.boxes import leave_boxes
from mecp_env.world.faces import from_face
from mecp_env.world.pedestrians import PACE, RADIUS, X, Y, walk

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
# People (n,11) and boxes (b,6), sizes (b,2) of the boxes, their place and reach (b,3), and a row (6,) of
# `crowd_kernels` that the robot is written to
DynamicObstacles = tuple[Array, Array, Array, Array, Array]

TOUCH_M = 1e-3  # a body in contact stays so far inside the wall, or the next substep would not see the contact
SPARE_M = 0.05  # what is pushed may be a little faster than the robot drives
PUSHED_M_S = 1e-6  # a contact is what changes the velocity by more than this

# The drive (11,): the command; how much the wheels change their speeds in a substep; how long one is; force and torque
# that change a velocity by one in it; how far the robot gets in it; how near a wall pymunk moves the robot, and where
# that is pushed out of it; how many substeps an arc has
SPEED, TURN, MOST_DV, MOST_DW, DT, FORCE, TORQUE, STRIDE, REACH, INNER, SUBSTEPS = range(11)
# The course (11,): the pose at the last reading; for the substep that pymunk makes next, the velocity that the wheels
# aim at, and the force and the torque for it; the velocity x, y and the turn rate that came of it
AIM_X, AIM_Y, FORCE_X, FORCE_Y, TWIST, FELT_X, FELT_Y, FELT_TURN = range(3, 11)


@compiled
def drive_on(
    segments: Array, state: Array, drive: Array, course: Array, increments: Array, done: int
) -> tuple[int, bool, bool]:
    """Takes the state (6,) over after substep `done` of the step, at its start or from pymunk, and drives on.

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


@compiled
def glide(segments: Array, state: Array, drive: Array, course: Array, increments: Array, done: int) -> int:
    """Moves the state (6,) while no wall is within reach, as pymunk would; returns the substep of the step reached.

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


@compiled
def move(state: Array, drive: Array, vx: float, vy: float, w: float) -> None:
    """Moves the state (6,) by a substep as pymunk does: with its velocity, which then becomes vx, vy, w."""
    state[0] += state[3] * drive[DT]
    state[1] += state[4] * drive[DT]
    state[2] += state[5] * drive[DT]
    state[3], state[4], state[5] = vx, vy, w


@compiled
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


@compiled
def aim(state: Array, drive: Array, course: Array, vx: float, vy: float, w: float) -> None:
    """Notes the velocity that the wheels aim at, and the force and torque that give it to the body in a substep."""
    course[AIM_X], course[AIM_Y] = vx, vy
    course[FORCE_X] = (vx - state[3]) * drive[FORCE]
    course[FORCE_Y] = (vy - state[4]) * drive[FORCE]
    course[TWIST] = (w - state[5]) * drive[TORQUE]


@compiled
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


@compiled
def wall_distance(segments: Array, x: float, y: float) -> float:
    """Distance from (x, y) to the nearest of the faces (S,2,2), m."""
    nearest = math.inf
    for k in range(segments.shape[0]):
        dx, dy = from_face(segments, k, x, y)
        nearest = min(nearest, dx * dx + dy * dy)
    return math.sqrt(nearest)


@compiled
def settle(segments: Array, state: Array, radius: float) -> bool:
    """Pushes the state's position out of all walls nearer than `radius`; returns whether there was none."""
    x, y = state[0], state[1]
    for _ in range(8):
        free = True
        for k in range(segments.shape[0]):
            dx, dy = from_face(segments, k, state[0], state[1])
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


@compiled
def drive_among(
    segments: Array,
    state: Array,
    drive: Array,
    course: Array,
    increments: Array,
    obstacles: DynamicObstacles,
    polite: bool,
    done: int,
) -> tuple[int, bool, bool]:
    """As `drive_on`, among people and boxes (see `DynamicObstacles`)."""
    touched, settled = False, True
    _, boxes, sizes, rounds, _ = obstacles
    if done > 0:
        touched = math.hypot(course[FELT_X] - course[AIM_X], course[FELT_Y] - course[AIM_Y]) > PUSHED_M_S
        move(state, drive, course[FELT_X], course[FELT_Y], course[FELT_TURN])
        settled = leave_boxes(boxes, sizes, state, drive[INNER])
        settled = settle(segments, state, drive[INNER]) and settled
    for i in range(boxes.shape[0]):
        rounds[i, 0], rounds[i, 1] = boxes[i, 0], boxes[i, 1]
    reached = glide_among(segments, state, drive, course, increments, obstacles, polite, done)
    return reached, touched, reached > done or not settled


@compiled
def glide_among(
    segments: Array,
    state: Array,
    drive: Array,
    course: Array,
    increments: Array,
    obstacles: DynamicObstacles,
    polite: bool,
    done: int,
) -> int:
    """As `glide`; the people take their steps too, also those of a substep that pymunk must make."""
    substeps, spare = int(drive[SUBSTEPS]), 0.0
    people, _, _, rounds, robot = obstacles
    read_arc(state, course, increments, done, substeps)
    while done < increments.shape[0] * substeps:
        if spare <= 0.0 or done % substeps == 0:
            spare = wall_distance(segments, state[0], state[1]) - drive[REACH]
        robot[0], robot[1], robot[2], robot[3] = state[0], state[1], state[3], state[4]
        walk(people, rounds, robot, polite, drive[DT])
        vx, vy, w = wheels(state, drive)
        if spare <= 0.0 or in_reach(obstacles, state, drive):
            aim(state, drive, course, vx, vy, w)
            return done
        spare -= drive[STRIDE]
        move(state, drive, vx, vy, w)
        done += 1
        read_arc(state, course, increments, done, substeps)
    return done


@compiled
def in_reach(obstacles: DynamicObstacles, state: Array, drive: Array) -> bool:
    """True when a box slides, or a pedestrian or a box is within reach of the robot's next substep."""
    people, boxes, _, rounds, _ = obstacles
    for i in range(people.shape[0]):
        reach = drive[REACH] + people[i, RADIUS] + people[i, PACE] * drive[DT]
        if math.hypot(people[i, X] - state[0], people[i, Y] - state[1]) < reach:
            return True
    for i in range(boxes.shape[0]):
        slides = boxes[i, 3] != 0.0 or boxes[i, 4] != 0.0 or boxes[i, 5] != 0.0
        near = math.hypot(rounds[i, 0] - state[0], rounds[i, 1] - state[1]) < drive[REACH] + rounds[i, 2]
        if slides or near:
            return True
    return False


@compiled
def who_is_near(obstacles: DynamicObstacles, state: Array, drive: Array) -> Ints:
    """The pedestrians, ascending, that the robot or a box may touch in pymunk's next substep."""
    people, boxes, _, rounds, _ = obstacles
    near, n = np.empty(people.shape[0], np.int64), 0
    for i in range(people.shape[0]):
        person = people[i]
        reach = person[RADIUS] + person[PACE] * drive[DT] + SPARE_M
        within = math.hypot(person[X] - state[0], person[Y] - state[1]) < drive[REACH] + reach
        for j in range(boxes.shape[0]):
            apart = math.hypot(person[X] - rounds[j, 0], person[Y] - rounds[j, 1])
            within = within or apart < rounds[j, 2] + drive[STRIDE] + reach
        if within:
            near[n] = i
            n += 1
    return near[:n]
