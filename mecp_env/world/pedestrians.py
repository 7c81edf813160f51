"""Compiled functions of the pedestrians: the velocity of each for a step, and the substeps in which it moves."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.world.faces import from_face

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

# A pedestrian (11,): position; velocity of this step; radius; preferred speed; remaining waiting time, time without
# progress, s; position at the start of the step; 1 in a substep in which it moves, else 0
X, Y, VX, VY, RADIUS, PACE, PAUSE, STUCK, FROM_X, FROM_Y, MOVES = range(11)
PERSON = 11
WALKS, ARRIVED, IS_STUCK = 0, 1, 2  # state of a pedestrian
# The robot (6,): place, velocity, radius, deceleration
ROBOT = 6

POLITE_M = 0.3  # distance that a polite pedestrian keeps from the robot and its stopping point
PRESS_M = 0.04  # others walk on until they overlap the robot by this
THERE_M = 0.15  # a place is reached
ROUNDING_M = 1e-9
SEE_M = 0.01  # clearance beside a leg
SOONEST_S = 0.5  # smallest time to collision
HORIZON_S, BERTH_M = 2.0, 0.3  # horizon for avoiding others, and distance to keep
PATIENCE_S = 3.0  # time without progress before a new destination
SLOW = 0.3  # less than this share of the preferred speed is no progress
TURNS = np.radians(np.array([0.0, -25.0, 25.0, -50.0, 50.0, -80.0, 80.0, -120.0, 120.0, 180.0]))  # prefer the right
SHARES = np.array([1.0, 0.5])


@compiled
def steer(
    people: Array, routes: Array, legs: Ints, segments: Array, boxes: Array, robot: Array, polite: bool, step: float
) -> Ints:
    """Choose a velocity for each of the pedestrians (n,11) for a step; returns the state of each (n,).

    `routes` (n,L,2) m and `legs` (n,2), the next point and how many there are; `boxes` (b,3): place and reach of each.
    No velocity chosen leads into one of the faces (S,2,2).
    """
    stands = np.empty(people.shape[0], np.int64)
    for i in range(people.shape[0]):
        person = people[i]
        note_progress(person, step)
        stands[i] = WALKS
        if person[PAUSE] > 0.0:
            person[PAUSE] -= step
        elif person[STUCK] > PATIENCE_S:
            stands[i] = IS_STUCK
        elif not look_ahead(person, routes[i], legs[i], segments):
            stands[i] = ARRIVED
        want_x, want_y = wanted(person, routes[i], legs[i], stands[i] == WALKS, step)
        careful = polite or person[STUCK] > 0.0
        choose(people, i, (want_x, want_y), segments, boxes, robot, (careful, polite), step)
    return stands


@compiled
def note_progress(person: Array, step: float) -> None:
    """Update the time without progress of a walking pedestrian."""
    moved = math.hypot(person[X] - person[FROM_X], person[Y] - person[FROM_Y])
    if person[PAUSE] > 0.0 or moved > SLOW * person[PACE] * step:
        person[STUCK] = 0.0
    else:
        person[STUCK] += step
    person[FROM_X], person[FROM_Y] = person[X], person[Y]


@compiled
def look_ahead(person: Array, route: Array, leg: Ints, segments: Array) -> bool:
    """Aim at the farthest next point of the route in free sight; False where the route ends."""
    while leg[0] + 1 < leg[1]:
        onward = route[leg[0] + 1]
        if not clear_leg(segments, person[X], person[Y], onward[0], onward[1], person[RADIUS] + SEE_M):
            break
        leg[0] += 1
    if leg[0] + 1 < leg[1]:
        return True
    return leg[1] > 0 and math.hypot(route[leg[0], 0] - person[X], route[leg[0], 1] - person[Y]) > THERE_M


@compiled
def wanted(person: Array, route: Array, leg: Ints, walks: bool, step: float) -> tuple[float, float]:
    """The velocity towards the next point, at most the preferred speed."""
    if not walks or person[PAUSE] > 0.0 or leg[1] == 0:
        return 0.0, 0.0
    dx, dy = route[leg[0], 0] - person[X], route[leg[0], 1] - person[Y]
    share = min(person[PACE] / max(math.hypot(dx, dy), 1e-9), 1.0 / step)
    return dx * share, dy * share


@compiled
def choose(
    people: Array,
    i: int,
    want: tuple[float, float],
    segments: Array,
    boxes: Array,
    robot: Array,
    manners: tuple[bool, bool],
    step: float,
) -> None:
    """Write the cheapest velocity of person i: near the wanted one, clear of walls, a berth from others.

    `manners`: whether it avoids pedestrians and boxes, and whether it avoids the robot.
    """
    person = people[i]
    best_x, best_y = 0.0, 0.0
    best = math.hypot(want[0], want[1]) / person[PACE] + crowding(people, i, (0.0, 0.0), boxes, robot, manners)
    heading, pace = math.atan2(want[1], want[0]), math.hypot(want[0], want[1])
    idle = pace == 0.0
    if idle and best == 0.0:
        person[VX], person[VY] = 0.0, 0.0
        return
    pace = person[PACE] if idle else pace
    for turn in TURNS:
        for share in SHARES:
            vx, vy = share * pace * math.cos(heading + turn), share * pace * math.sin(heading + turn)
            cost = math.hypot(vx - want[0], vy - want[1]) / person[PACE]
            if cost >= best:
                continue
            cost += crowding(people, i, (vx, vy), boxes, robot, manners)
            to_x, to_y = person[X] + vx * step, person[Y] + vy * step
            if cost < best and clear_leg(segments, person[X], person[Y], to_x, to_y, person[RADIUS]):
                best, best_x, best_y = cost, vx, vy
    person[VX], person[VY] = best_x, best_y


@compiled
def crowding(
    people: Array, i: int, velocity: tuple[float, float], boxes: Array, robot: Array, manners: tuple[bool, bool]
) -> float:
    """Cost of a velocity of pedestrian i for coming close to others within the horizon."""
    cost, person = 0.0, people[i]
    for j in range(people.shape[0] if manners[0] else 0):
        if j != i:
            apart = person[RADIUS] + people[j, RADIUS]
            ahead = people[j, X] - person[X], people[j, Y] - person[Y]
            cost += nearness(ahead, (velocity[0] - people[j, VX], velocity[1] - people[j, VY]), apart, BERTH_M)
    for j in range(boxes.shape[0] if manners[0] else 0):
        ahead = boxes[j, 0] - person[X], boxes[j, 1] - person[Y]
        cost += nearness(ahead, velocity, person[RADIUS] + boxes[j, 2], 0.5 * BERTH_M)
    if manners[1]:
        ahead = robot[0] - person[X], robot[1] - person[Y]
        apart = person[RADIUS] + robot[4] + POLITE_M
        cost += 2.0 * nearness(ahead, (velocity[0] - robot[2], velocity[1] - robot[3]), apart, BERTH_M)
    return cost


@compiled
def nearness(ahead: tuple[float, float], closing: tuple[float, float], apart: float, berth: float) -> float:
    """Cost of meeting something that lies `ahead`, with the relative velocity `closing`: 3 for a hit now, 0 for none.

    At `apart` metres they touch; `berth` more costs nothing.
    """
    speed2 = closing[0] * closing[0] + closing[1] * closing[1]
    time = (ahead[0] * closing[0] + ahead[1] * closing[1]) / speed2 if speed2 > 1e-12 else 0.0
    time = min(max(time, SOONEST_S), HORIZON_S)
    gap = math.hypot(ahead[0] - time * closing[0], ahead[1] - time * closing[1]) - apart
    if gap >= berth:
        return 0.0
    return (3.0 if gap < 0.0 else 1.0 - gap / berth) * (1.0 - 0.8 * time / HORIZON_S) + max(-gap, 0.0)


@compiled
def clear_leg(segments: Array, x0: float, y0: float, x1: float, y1: float, radius: float) -> bool:
    """True when a disc that goes straight from (x0, y0) to (x1, y1) touches none of the faces (S,2,2).

    Begun nearer to a face than its radius, it comes no nearer.
    """
    dx, dy = x1 - x0, y1 - y0
    length2 = dx * dx + dy * dy
    reach = radius + math.sqrt(length2)
    for k in range(segments.shape[0]):
        to_x, to_y = from_face(segments, k, x0, y0)
        square = to_x * to_x + to_y * to_y
        if square >= reach * reach:
            continue
        least = min(radius, math.sqrt(square)) - ROUNDING_M
        to_x, to_y = from_face(segments, k, x1, y1)
        if math.hypot(to_x, to_y) < least or crosses(segments[k], x0, y0, x1, y1):
            return False
        for end in range(2):
            px, py = segments[k, end, 0] - x0, segments[k, end, 1] - y0
            share = min(max((px * dx + py * dy) / max(length2, 1e-12), 0.0), 1.0)
            if math.hypot(px - share * dx, py - share * dy) < least:
                return False
    return True


@compiled
def crosses(face: Array, x0: float, y0: float, x1: float, y1: float) -> bool:
    """True when the leg from (x0, y0) to (x1, y1) crosses the face (2,2)."""
    ux, uy = face[1, 0] - face[0, 0], face[1, 1] - face[0, 1]
    before = ux * (y0 - face[0, 1]) - uy * (x0 - face[0, 0])
    after = ux * (y1 - face[0, 1]) - uy * (x1 - face[0, 0])
    dx, dy = x1 - x0, y1 - y0
    left = dx * (face[0, 1] - y0) - dy * (face[0, 0] - x0)
    right = dx * (face[1, 1] - y0) - dy * (face[1, 0] - x0)
    return bool(before * after < 0.0 and left * right < 0.0)


@compiled
def walk(people: Array, boxes: Array, robot: Array, polite: bool, dt: float) -> None:
    """One substep of all pedestrians; one that would step into another, into a box, or too close to the robot, waits.

    It keeps its velocity and tries again in the next substep.
    """
    for i in range(people.shape[0]):
        vx, vy = people[i, VX], people[i, VY]
        people[i, MOVES] = 0.0
        if (vx != 0.0 or vy != 0.0) and may_step(people, i, boxes, robot, polite, dt):
            people[i, MOVES] = 1.0
            people[i, X] += vx * dt
            people[i, Y] += vy * dt


@compiled
def may_step(people: Array, i: int, boxes: Array, robot: Array, polite: bool, dt: float) -> bool:
    """True when the next substep of pedestrian i brings it closer to no object that is then too close."""
    person = people[i]
    for j in range(people.shape[0]):
        if j != i and closes_in(person, people[j, X], people[j, Y], person[RADIUS] + people[j, RADIUS], dt):
            return False
    for j in range(boxes.shape[0]):
        if closes_in(person, boxes[j, 0], boxes[j, 1], person[RADIUS] + boxes[j, 2], dt):
            return False
    apart = person[RADIUS] + robot[4]
    if not polite:
        return not closes_in(person, robot[0], robot[1], apart - PRESS_M, dt)
    speed = math.hypot(robot[2], robot[3])
    ahead = speed / robot[5]  # s, until it stops
    share = 0.0
    for _ in range(3):  # where it is, half-way to where it can stop, and there
        x, y = robot[0] + share * ahead * robot[2], robot[1] + share * ahead * robot[3]
        if closes_in(person, x, y, apart + POLITE_M, dt):
            return False
        share += 0.5
    return True


@compiled
def closes_in(person: Array, x: float, y: float, apart: float, dt: float) -> bool:
    """True when a substep ends nearer than `apart` to (x, y), and nearer than it began."""
    dx, dy = person[X] - x, person[Y] - y
    after = math.hypot(dx + person[VX] * dt, dy + person[VY] * dt)
    return after < apart and after < math.hypot(dx, dy)
