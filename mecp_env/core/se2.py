"""Plane geometry shared by the stages: angles, rotations, rigid transforms. Poses are (x, y, heading).

Many poses (n,3) x, y, heading at once, in NumPy: relative poses, chains, and poses between two stamps.
"""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.jit import compiled


@compiled
def wrap_angle(angle: float) -> float:
    """`angle` in (-pi, pi]."""
    if -3.0 < angle < 3.0:  # nearly all of them; below, 0 would be taken from them
        return angle
    wrapped = angle - 2.0 * math.pi * np.floor((angle + math.pi) / (2.0 * math.pi))
    return math.pi if wrapped <= -math.pi else wrapped


@compiled
def face_turn(normals: Array, heading: float, known: Array) -> float:
    """The largest turn (rad) between the faces (of two) that both have seen; -1 without any.

    `normals` (2,) rad are turned by `heading`, `known` (2,) rad are not; nan: unseen.
    """
    largest = -1.0
    for side in range(2):
        turn = abs(wrap_angle(normals[side] + heading - known[side]))
        if turn > largest:
            largest = turn
    return largest


@compiled
def to_map(T_map_robot: Array, p_robot: Array) -> Array:
    """Points (n,2) of the robot frame in the map frame."""
    c, s = math.cos(T_map_robot[2]), math.sin(T_map_robot[2])
    p_map = np.empty_like(p_robot)
    for i in range(p_robot.shape[0]):
        p_map[i, 0] = T_map_robot[0] + c * p_robot[i, 0] - s * p_robot[i, 1]
        p_map[i, 1] = T_map_robot[1] + s * p_robot[i, 0] + c * p_robot[i, 1]
    return p_map


def to_robot(T_map_robot: Array, p_map: Array) -> Array:
    """Points (n,2) of the map frame in the robot frame."""
    c, s = math.cos(T_map_robot[2]), math.sin(T_map_robot[2])
    dx, dy = (p_map - T_map_robot[:2]).T
    return np.stack((c * dx + s * dy, -s * dx + c * dy), axis=1)


@compiled
def compose(T_a_b: Array, T_b_c: Array) -> Array:
    """T_a_c = T_a_b T_b_c, each (3,): x, y, heading."""
    c, s = math.cos(T_a_b[2]), math.sin(T_a_b[2])
    T_a_c = np.empty(3)
    T_a_c[0] = T_a_b[0] + c * T_b_c[0] - s * T_b_c[1]
    T_a_c[1] = T_a_b[1] + s * T_b_c[0] + c * T_b_c[1]
    T_a_c[2] = wrap_angle(T_a_b[2] + T_b_c[2])
    return T_a_c


@compiled
def inverse(T_a_b: Array) -> Array:
    """T_b_a (3,) of T_a_b (3,)."""
    c, s = math.cos(T_a_b[2]), math.sin(T_a_b[2])
    T_b_a = np.empty(3)
    T_b_a[0] = -c * T_a_b[0] - s * T_a_b[1]
    T_b_a[1] = s * T_a_b[0] - c * T_a_b[1]
    T_b_a[2] = wrap_angle(-T_a_b[2])
    return T_b_a


@compiled
def polar_to_points(z: Array) -> Array:
    """Points (n,2) of ranges and bearings z (n,2)."""
    points = np.empty_like(z)
    for i in range(z.shape[0]):
        points[i, 0] = z[i, 0] * math.cos(z[i, 1])
        points[i, 1] = z[i, 0] * math.sin(z[i, 1])
    return points


def inside_polygon(x: float, y: float, ring: Array) -> bool:
    """True when (x, y) lies inside the simple polygon `ring` (k,2) (even-odd rule)."""
    before = np.roll(ring, 1, axis=0)
    across = (ring[:, 1] > y) != (before[:, 1] > y)
    (ax, ay), (bx, by) = ring[across].T, before[across].T
    return bool(np.sum(x < (bx - ax) * (y - ay) / (by - ay) + ax) % 2)


def wrapped(angles: Array) -> Array:
    """Angles (n,) rad in [-pi, pi)."""
    turned: Array = (angles + np.pi) % (2.0 * np.pi) - np.pi
    return turned


def as_bearings(angles: Array) -> Array:
    """Angles (n,) rad in (-pi, pi]."""
    turned: Array = np.pi - np.mod(np.pi - angles, 2.0 * np.pi)
    return turned


def composed(T_a_b: Array, T_b_c: Array) -> Array:
    """T_a_c (n,3) of T_a_b and T_b_c, each (n,3) or (3,)."""
    x, y, heading = np.moveaxis(T_a_b, -1, 0)
    dx, dy, turn = np.moveaxis(T_b_c, -1, 0)
    c, s = np.cos(heading), np.sin(heading)
    return np.stack((x + c * dx - s * dy, y + s * dx + c * dy, wrapped(heading + turn)), axis=-1)


def between(T_a_b: Array, T_a_c: Array) -> Array:
    """T_b_c (n,3) of T_a_b and T_a_c, each (n,3) or (3,)."""
    dx, dy, turn = np.moveaxis(T_a_c - T_a_b, -1, 0)
    c, s = np.cos(T_a_b[..., 2]), np.sin(T_a_b[..., 2])
    return np.stack((c * dx + s * dy, -s * dx + c * dy, wrapped(turn)), axis=-1)


def chained(steps: Array) -> Array:
    """Poses (n+1,3) in the frame of the first, of the poses of each in its predecessor (n,3)."""
    headings = np.concatenate(([0.0], np.cumsum(steps[:, 2])))
    c, s = np.cos(headings[:-1]), np.sin(headings[:-1])
    moves = np.stack((c * steps[:, 0] - s * steps[:, 1], s * steps[:, 0] + c * steps[:, 1]), axis=1)
    places = np.concatenate((np.zeros((1, 2)), np.cumsum(moves, axis=0)))
    return np.column_stack((places, wrapped(headings)))


def interpolated(t: Array, T: Array, at: Array) -> Array:
    """Poses (k,3) at the stamps `at` (k,) between poses T (n,3) at ascending stamps t (n,); the ends go on."""
    headings = np.unwrap(T[:, 2])
    columns = [np.interp(at, t, column) for column in (T[:, 0], T[:, 1], headings)]
    return np.column_stack((*columns[:2], wrapped(columns[2])))
