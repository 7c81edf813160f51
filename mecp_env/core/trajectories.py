"""Many poses (n,3) x, y, heading at once, in NumPy: relative poses, chains, and poses between two stamps."""

from __future__ import annotations

import numpy as np

from mecp_env.core.array_types import Array


def wrapped(angles: Array) -> Array:
    """Angles (n,) rad in [-pi, pi)."""
    turned: Array = (angles + np.pi) % (2.0 * np.pi) - np.pi
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
