"""A path against a reference: absolute error after the best rigid alignment, and relations measured by hand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.se2 import between, composed, interpolated, wrapped

COINCIDENT_S = 1e-3  # a relation whose stamps differ by less from those of two poses needs no interpolation


class TrajectoryError(NamedTuple):
    """The absolute trajectory error (ATE)."""

    rmse_m: float  # of the positions
    worst_m: float
    rmse_rad: float  # of the headings


class RelationError(NamedTuple):
    """The error of relative poses (Kuemmerle et al. 2009)."""

    mean_m: float  # of the translation
    mean_rad: float  # of the absolute rotation
    sd_m: float
    sd_rad: float
    relations: int  # that were compared


def align(p_a: Array, p_b: Array) -> Array:
    """T_a_b (3,) that brings points p_b (n,2) nearest to p_a (n,2) in the sense of least squares, without scale."""
    mean_a, mean_b = p_a.mean(axis=0), p_b.mean(axis=0)
    (ax, ay), (bx, by) = (p_a - mean_a).T, (p_b - mean_b).T
    turn = math.atan2(float(bx @ ay - by @ ax), float(bx @ ax + by @ ay))
    moved = composed(np.array([0.0, 0.0, turn]), np.array([*mean_b, 0.0]))
    return np.array([*(mean_a - moved[:2]), turn])


def trajectory_error(T_map_robot: Array, T_ref_robot: Array) -> TrajectoryError:
    """The ATE of poses (n,3) against those of a reference (n,3) at the same stamps; rows with nan are left out."""
    known = np.isfinite(T_map_robot).all(axis=1) & np.isfinite(T_ref_robot).all(axis=1)
    if not known.any():
        return TrajectoryError(math.nan, math.nan, math.nan)
    T_map_robot, T_ref_robot = T_map_robot[known], T_ref_robot[known]
    T_ref_map = align(T_ref_robot[:, :2], T_map_robot[:, :2])
    aligned = composed(T_ref_map, T_map_robot)
    off_m = np.hypot(*(aligned - T_ref_robot)[:, :2].T)
    off_rad = wrapped(aligned[:, 2] - T_ref_robot[:, 2])
    return TrajectoryError(_rms(off_m), float(off_m.max()), _rms(off_rad))


def relation_error(t: Array, T_map_robot: Array, relations: Array) -> RelationError:
    """The mean error of the relations between the first and last stamp.

    `t` (n,) s ascending, poses (n,3), `relations` (k,5) as in `Log`. Poses are interpolated.
    """
    asked = relations[((relations[:, :2] >= t[0]) & (relations[:, :2] <= t[-1])).all(axis=1)]
    if not len(asked):
        return RelationError(math.nan, math.nan, math.nan, math.nan, 0)
    first, second = (interpolated(t, T_map_robot, asked[:, column]) for column in (0, 1))
    off = between(asked[:, 2:], between(first, second))
    errors = np.column_stack((np.hypot(off[:, 0], off[:, 1]), abs(off[:, 2])))
    (mean_m, mean_rad), (sd_m, sd_rad) = errors.mean(axis=0).tolist(), errors.std(axis=0).tolist()
    return RelationError(mean_m, mean_rad, sd_m, sd_rad, len(errors))


def coincident(t: Array, relations: Array) -> Array:
    """The relations (m,5) whose stamps are those of poses at t (n,)."""
    after = np.searchsorted(t, relations[:, :2]).clip(1, len(t) - 1)
    off = np.minimum(abs(t[after] - relations[:, :2]), abs(t[after - 1] - relations[:, :2]))
    found: Array = relations[(off < COINCIDENT_S).all(axis=1)]
    return found


def tum(t: Sequence[float] | Array, poses: Sequence[Array] | Array) -> str:
    """Poses (n,3) at the stamps t (n,) s as lines `time x y z qx qy qz qw`, the format that `evo` reads."""
    lines = ["# time x y z qx qy qz qw (s, m, quaternion), map frame"]
    for stamp, (x, y, heading) in zip(t, poses, strict=True):
        turn = f"0 0 {math.sin(heading / 2):.9f} {math.cos(heading / 2):.9f}"
        lines.append(f"{stamp:.6f} {x:.6f} {y:.6f} 0 {turn}")
    return "\n".join(lines) + "\n"


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2)))
