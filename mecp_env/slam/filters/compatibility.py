"""How well measurements fit landmarks: single, joint and iterated tests, and the mean of Gaussians of a polygon.

The one place where a filter that diverges is noticed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import TracebackType

import numpy as np

from mecp_env.core.arrays import find_rows
from mecp_env.core.carriers import Array, Ints
from mecp_env.core.jit import compiled
from mecp_env.core.linalg import factor_lower, quadratic, solve_lower
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.filters.models import change_chart, innovation_cov, left_jacobian, linearise, project, residual
from mecp_env.slam.filters.update import gauss_newton, take
from mecp_env.slam.messages import Belief
from mecp_env.slam.protocols import FilterError

FAR = 1e4  # a range or bearing alone that gives this NIS makes the pair "absurdly far": inf; beyond every gate


@compiled
def pairwise_nis(state: Array, slot_ids: Ints, ids: Ints, z: Array, R: Array, invariant: bool, nis: Array) -> bool:
    """Write the NIS (n,m) of every z (n,2), R (n,2,2) against every landmark of `ids` (m,); False: an unknown id.

    A pair is inf where it is far, or where its S is not positive.
    """
    n, m, mean, cov = z.shape[0], ids.shape[0], state[0], state[1:]
    slots, h, A, a_heading = np.empty(m, np.int64), np.empty((m, 2)), np.empty((m, 2, 2)), np.empty((m, 2))
    if not find_rows(slot_ids, ids, slots):
        return False
    linearise(mean, slots, invariant, h, A, a_heading)
    for j in range(m):
        i = 3 + 2 * slots[j]
        tt, tx, ty = cov[0, 0], cov[0, i] - cov[0, 1], cov[0, i + 1] - cov[0, 2]  # of the heading and l - p
        xx = cov[i, i] - 2.0 * cov[1, i] + cov[1, 1]
        xy = cov[i, i + 1] - cov[1, i + 1] - cov[2, i] + cov[1, 2]
        yy = cov[i + 1, i + 1] - 2.0 * cov[2, i + 1] + cov[2, 2]
        rx, ry, rt = A[j, 0, 0], A[j, 0, 1], a_heading[j, 0]
        bx, by, bt = A[j, 1, 0], A[j, 1, 1], a_heading[j, 1]
        gx, gy, gt = rx * xx + ry * xy + rt * tx, rx * xy + ry * yy + rt * ty, rx * tx + ry * ty + rt * tt
        kx, ky, kt = bx * xx + by * xy + bt * tx, bx * xy + by * yy + bt * ty, bx * tx + by * ty + bt * tt
        s_rr, s_rb = gx * rx + gy * ry + gt * rt, gx * bx + gy * by + gt * bt  # H P H^T
        s_bb = kx * bx + ky * by + kt * bt
        for i in range(n):
            u, s_uu = z[i, 0] - h[j, 0], s_rr + R[i, 0, 0]
            nis[i, j] = math.inf
            if not u * u < FAR * s_uu:  # most pairs fail by their range alone
                continue
            v, s_uv, s_vv = wrap_angle(z[i, 1] - h[j, 1]), s_rb + R[i, 1, 0], s_bb + R[i, 1, 1]
            det = s_uu * s_vv - s_uv * s_uv
            if det > 0.0 and v * v < FAR * s_vv:
                nis[i, j] = (s_vv * u * u - 2.0 * s_uv * u * v + s_uu * v * v) / det
    return True


@compiled
def joint_cost(state: Array, slot_ids: Ints, ids: Ints, z: Array, R: Array, invariant: bool, iterations: int) -> float:
    """Least prior + measurement cost over pose and landmarks `ids` (m,); nan: S is not positive, or an unknown id.

    iterations = 1: the linear joint NIS nu^T S^-1 nu. More: Gauss-Newton from the pose that lays z best on the
    landmarks (at its fixed point nu^T S^-1 nu with nu = z - h + H xi is the sum of both costs).
    """
    m = ids.shape[0]
    slots = np.empty(m, np.int64)
    if not find_rows(slot_ids, ids, slots):
        return math.nan
    part = take(state, slots)
    size = part.shape[1]
    xi = np.zeros(size)
    if iterations > 1:
        procrustes(part[0], z, invariant, xi)
    cost, _ = gauss_newton(part, size, np.arange(m), z, R, invariant, iterations, xi)
    return cost


@compiled
def log_bayes_factor(
    state: Array, slot_ids: Ints, ids: Ints, z: Array, R: Array, invariant: bool, noise: Array
) -> float:
    """Twice the log of p(z | pose noise is larger by `noise`) / p(z | as it is); nan: S not positive, or unknown id.

    `noise` (3,3) of x, y, heading. S of the larger noise is S + D noise D^T, D the derivative of z by the pose.
    """
    m = ids.shape[0]
    slots, h, A, a_heading = np.empty(m, np.int64), np.empty((m, 2)), np.empty((m, 2, 2)), np.empty((m, 2))
    if not find_rows(slot_ids, ids, slots):
        return math.nan
    part, own = take(state, slots), np.arange(m)
    size, nu, S, D = part.shape[1], np.empty(2 * m), np.empty((2 * m, 2 * m)), np.empty((2 * m, 3))
    linearise(part[0], own, invariant, h, A, a_heading)
    residual(z, h, A, a_heading, own, np.zeros(size), nu)
    innovation_cov(project(part[1:], size, A, a_heading, own), A, a_heading, own, R, S)
    for k in range(m):
        for r in range(2):
            D[2 * k + r, 0], D[2 * k + r, 1], D[2 * k + r, 2] = -A[k, r, 0], -A[k, r, 1], -1.0 * r
    wider = S.copy()
    for i in range(2 * m):
        for j in range(i + 1):
            wider[i, j] += quadratic(noise, D[i], D[j])
    if not (factor_lower(S) and factor_lower(wider)):
        return math.nan
    y, y_wider, factor = solve_lower(S, nu), solve_lower(wider, nu), 0.0
    for i in range(2 * m):
        factor += y[i] * y[i] - y_wider[i] * y_wider[i] - 2.0 * math.log(wider[i, i] / S[i, i])
    return factor


@compiled
def procrustes(part: Array, z: Array, invariant: bool, xi: Array) -> None:
    """Write to xi the error of the pose that lays the measured points best (least squares) on the landmarks.

    `part` is the mean of pose and landmarks; every landmark stays where it is.
    """
    m = z.shape[0]
    mx, my, lx, ly = 0.0, 0.0, 0.0, 0.0
    points = np.empty((m, 2))
    for k in range(m):
        points[k, 0], points[k, 1] = z[k, 0] * math.cos(z[k, 1]), z[k, 0] * math.sin(z[k, 1])
        mx, my = mx + points[k, 0] / m, my + points[k, 1] / m
        lx, ly = lx + part[3 + 2 * k] / m, ly + part[4 + 2 * k] / m
    along, across = 0.0, 0.0
    for k in range(m):
        ux, uy = points[k, 0] - mx, points[k, 1] - my
        vx, vy = part[3 + 2 * k] - lx, part[4 + 2 * k] - ly
        along += ux * vx + uy * vy
        across += ux * vy - uy * vx
    heading = math.atan2(across, along) if along != 0.0 or across != 0.0 else part[0]
    c, s = math.cos(heading), math.sin(heading)
    x, y = lx - c * mx + s * my, ly - s * mx - c * my
    xi[0] = wrap_angle(heading - part[0])
    if not invariant:
        xi[1], xi[2] = x - part[1], y - part[2]
        return
    c, s = math.cos(xi[0]), math.sin(xi[0])
    a, b = left_jacobian(xi[0])
    det = a * a + b * b
    for i in range(1, part.shape[0], 2):
        to_x, to_y = (x, y) if i == 1 else (part[i], part[i + 1])
        ux = to_x - c * part[i] + s * part[i + 1]
        uy = to_y - s * part[i] - c * part[i + 1]
        xi[i], xi[i + 1] = (a * ux + b * uy) / det, (a * uy - b * ux) / det


@compiled
def centre_nis(state: Array, slot_ids: Ints, ids: Ints, z: Array, R: Array, invariant: bool, paper_S: bool) -> float:
    """NIS of the centre of the points z (k,2) against the centre of the landmarks `ids` (eq. 2, 3).

    nan: S is not positive, or an unknown id.

    nu = m_obs - m_map, S = H P H^T + B R B^T with H = [J (m_obs - p) | I | -I/k ...]; the heading's column vanishes for
    the invariant error. paper_S: observed and stored centre count as independent, their cross term C is dropped.
    """
    k = ids.shape[0]
    slots = np.empty(k, np.int64)
    if not find_rows(slot_ids, ids, slots):
        return math.nan
    part = take(state, slots)
    mean, cov = part[0], part[1:]
    B, H, S, centre = np.empty((2, 2 * k)), np.zeros((2, mean.shape[0])), np.empty((2, 2)), mean[1:3].copy()
    for i in range(k):
        c, s = math.cos(mean[0] + z[i, 1]) / k, math.sin(mean[0] + z[i, 1]) / k
        B[0, 2 * i], B[0, 2 * i + 1] = c, -z[i, 0] * s
        B[1, 2 * i], B[1, 2 * i + 1] = s, z[i, 0] * c
        centre[0] += z[i, 0] * c
        centre[1] += z[i, 0] * s
    if paper_S:
        change_chart(part, mean.shape[0], 1.0, invariant)
        cov[:3, 3:] = 0.0
        cov[3:, :3] = 0.0
    nu = centre.copy()
    for r in range(2):
        H[r, 1 + r] = 1.0
        for j in range(k):
            H[r, 3 + 2 * j + r] = -1.0 / k
            nu[r] -= mean[3 + 2 * j + r] / k
    if paper_S or not invariant:
        H[0, 0], H[1, 0] = mean[2] - centre[1], centre[0] - mean[1]
    for r in range(2):
        for c_ in range(2):
            S[r, c_] = quadratic(R, B[r], B[c_]) + quadratic(cov, H[r], H[c_])
    if not factor_lower(S):
        return math.nan
    y = solve_lower(S, nu)
    return float(y[0] * y[0] + y[1] * y[1])


@dataclass(slots=True, eq=False)
class Divergence:
    """Whether the filter has diverged so far. As a context, it ends the block at a `FilterError` and notes it."""

    limit_m: float  # a pose with a larger sigma in x or y is worth nothing any more
    found: bool = False

    def watch(self, belief: Belief) -> Belief:
        """`belief` itself; the sigma of its position is compared with the limit."""
        self.found |= not max(belief.pose_cov[0, 0], belief.pose_cov[1, 1]) < self.limit_m**2
        return belief

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> bool:
        failed = isinstance(error, FilterError)
        self.found |= failed
        return failed
