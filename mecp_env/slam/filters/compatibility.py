"""How well measurements fit landmarks: single, joint and iterated tests, and the mean of Gaussians of a polygon."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.core.linalg import factor_lower, solve_lower
from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.filters.error_state import change_chart, left_jacobian, linearise, world_jacobian
from mecp_env.slam.filters.landmarks import find_slots, take
from mecp_env.slam.filters.measurement import innovation_cov, project, residual

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

FAR = 1e4  # a range or bearing alone that gives this NIS makes the pair "absurdly far": inf
CONVERGED = 1e-6  # m and rad


@compiled
def pairwise_nis(
    mean: Array,
    cov: Array,
    slot_ids: Ints,
    count: int,
    ids: Ints,
    z: Array,
    R: Array,
    invariant: bool,
    nis: Array,
) -> bool:
    """Write the NIS (n,m) of every z (n,2), R (n,2,2) against every landmark of `ids` (m,); False: an unknown id."""
    n, m = z.shape[0], ids.shape[0]
    slots, h, A, a_heading = np.empty(m, np.int64), np.empty((m, 2)), np.empty((m, 2, 2)), np.empty((m, 2))
    if not find_slots(slot_ids, count, ids, slots):
        return False
    linearise(mean, np.zeros(mean.shape[0]), slots, invariant, h, A, a_heading)
    for j in range(m):
        s_rr, s_rb, s_bb = predicted_cov(cov, 3 + 2 * slots[j], A[j], a_heading[j])
        for i in range(n):
            u, s_uu = z[i, 0] - h[j, 0], s_rr + R[i, 0, 0]
            nis[i, j] = math.inf
            if u * u < FAR * s_uu:  # most pairs fail by their range alone
                v = wrap_angle(z[i, 1] - h[j, 1])
                nis[i, j] = nis_2x2(u, v, s_uu, s_rb + R[i, 1, 0], s_bb + R[i, 1, 1])
    return True


@compiled
def predicted_cov(cov: Array, i: int, A: Array, a_heading: Array) -> tuple[float, float, float]:
    """H P H^T of one landmark at rows i and i + 1: its range-range, range-bearing and bearing-bearing entries."""
    tt, tx, ty = cov[0, 0], cov[0, i] - cov[0, 1], cov[0, i + 1] - cov[0, 2]  # of the heading and l - p
    xx = cov[i, i] - 2.0 * cov[1, i] + cov[1, 1]
    xy = cov[i, i + 1] - cov[1, i + 1] - cov[2, i] + cov[1, 2]
    yy = cov[i + 1, i + 1] - 2.0 * cov[2, i + 1] + cov[2, 2]
    rx, ry, rt = A[0, 0], A[0, 1], a_heading[0]
    bx, by, bt = A[1, 0], A[1, 1], a_heading[1]
    gx, gy, gt = rx * xx + ry * xy + rt * tx, rx * xy + ry * yy + rt * ty, rx * tx + ry * ty + rt * tt
    kx, ky, kt = bx * xx + by * xy + bt * tx, bx * xy + by * yy + bt * ty, bx * tx + by * ty + bt * tt
    return gx * rx + gy * ry + gt * rt, gx * bx + gy * by + gt * bt, kx * bx + ky * by + kt * bt


@compiled
def nis_2x2(u: float, v: float, s_uu: float, s_uv: float, s_vv: float) -> float:
    """NIS of (u, v) under [[s_uu, s_uv], [s_uv, s_vv]]; inf where far, or where S is not positive."""
    det = s_uu * s_vv - s_uv * s_uv
    if not (det > 0.0 and u * u < FAR * s_uu and v * v < FAR * s_vv):
        return math.inf
    return (s_vv * u * u - 2.0 * s_uv * u * v + s_uu * v * v) / det


@compiled
def joint_cost(
    mean: Array,
    cov: Array,
    slot_ids: Ints,
    count: int,
    ids: Ints,
    z: Array,
    R: Array,
    invariant: bool,
    iterations: int,
) -> float:
    """Least prior + measurement cost over pose and landmarks `ids` (m,); nan: S is not positive, or an unknown id.

    iterations = 1: the linear joint NIS nu^T S^-1 nu. More: Gauss-Newton from the pose that lays z best on the
    landmarks (at its fixed point nu^T S^-1 nu with nu = z - h(xi) + H xi is the sum of both costs).
    """
    m = ids.shape[0]
    slots, h, A, a_heading = np.empty(m, np.int64), np.empty((m, 2)), np.empty((m, 2, 2)), np.empty((m, 2))
    if not find_slots(slot_ids, count, ids, slots):
        return math.nan
    part, block = take(mean, cov, slots)
    size, own = part.shape[0], np.arange(m)
    nu, S, xi = np.empty(2 * m), np.empty((2 * m, 2 * m)), np.zeros(size)
    if iterations > 1:
        procrustes(part, z, invariant, xi)
    cost = math.nan
    for _ in range(iterations):
        linearise(part, xi, own, invariant, h, A, a_heading)
        residual(z, h, A, a_heading, own, xi, nu)
        HP = project(block, size, A, a_heading, own)
        innovation_cov(HP, A, a_heading, own, R, S)
        if not factor_lower(S):
            return math.nan
        y = solve_lower(S, nu)
        cost = dot(y, y)
        solve_upper(S, y)
        if blend(HP, y, xi) < CONVERGED:
            break
    return cost


@compiled
def procrustes(part: Array, z: Array, invariant: bool, xi: Array) -> None:
    """Write to xi the error of the pose that lays the measured points best (least squares) on the landmarks."""
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
    xi[0] = wrap_angle(heading - part[0])
    set_positions(part, lx - c * mx + s * my, ly - s * mx - c * my, invariant, xi)


@compiled
def set_positions(part: Array, x: float, y: float, invariant: bool, xi: Array) -> None:
    """Complete xi, whose turn is set, so that the robot is at (x, y) and every landmark stays where it is."""
    if not invariant:
        xi[1], xi[2] = x - part[1], y - part[2]
        return
    c, s = math.cos(xi[0]), math.sin(xi[0])
    a, b, _, _ = left_jacobian(xi[0])
    det = a * a + b * b
    for i in range(1, part.shape[0], 2):
        to_x, to_y = (x, y) if i == 1 else (part[i], part[i + 1])
        ux = to_x - c * part[i] + s * part[i + 1]
        uy = to_y - s * part[i] - c * part[i + 1]
        xi[i], xi[i + 1] = (a * ux + b * uy) / det, (a * uy - b * ux) / det


@compiled
def dot(a: Array, b: Array) -> float:
    """a . b"""
    total = 0.0
    for i in range(a.shape[0]):
        total += a[i] * b[i]
    return total


@compiled
def solve_upper(L: Array, y: Array) -> None:
    """Replace y (n,) by x of L^T x = y."""
    for i in range(y.shape[0] - 1, -1, -1):
        for k in range(i + 1, y.shape[0]):
            y[i] -= L[k, i] * y[k]
        y[i] /= L[i, i]


@compiled
def blend(HP: Array, weights: Array, xi: Array) -> float:
    """Replace xi (n,) by HP^T weights; returns the largest change."""
    step = 0.0
    for j in range(xi.shape[0]):
        new = 0.0
        for k in range(HP.shape[0]):
            new += HP[k, j] * weights[k]
        step = max(step, abs(new - xi[j]))
        xi[j] = new
    return step


@compiled
def centre_nis(
    mean: Array,
    cov: Array,
    slot_ids: Ints,
    count: int,
    ids: Ints,
    z: Array,
    R: Array,
    invariant: bool,
    paper_S: bool,
) -> float:
    """NIS of the centre of the points z (k,2) against the centre of the landmarks `ids` (eq. 2, 3).

    nan: S is not positive, or an unknown id.

    nu = m_obs - m_map, S = H P H^T + noise with H = [J (m_obs - p) | I | -I/k ...]; the heading's column vanishes for
    the invariant error. paper_S: observed and stored centre count as independent, their cross term C is dropped.
    """
    k = ids.shape[0]
    slots = np.empty(k, np.int64)
    if not find_slots(slot_ids, count, ids, slots):
        return math.nan
    part, block = take(mean, cov, slots)
    noise, centre = observed_centre(part, z, R)
    plain = paper_S or not invariant
    if paper_S:
        change_chart(block, part.shape[0], world_jacobian(part, part.shape[0], invariant))
        block[:3, 3:] = 0.0
        block[3:, :3] = 0.0
    H = np.zeros((2, part.shape[0]))
    nu = centre.copy()
    for r in range(2):
        H[r, 1 + r] = 1.0
        for j in range(k):
            H[r, 3 + 2 * j + r] = -1.0 / k
            nu[r] -= part[3 + 2 * j + r] / k
    if plain:
        H[0, 0], H[1, 0] = part[2] - centre[1], centre[0] - part[1]
    S = noise
    for r in range(2):
        for c in range(2):
            S[r, c] += quadratic(block, H[r], H[c])
    if not factor_lower(S):
        return math.nan
    y = solve_lower(S, nu)
    return dot(y, y)


@compiled
def observed_centre(part: Array, z: Array, R: Array) -> tuple[Array, Array]:
    """Sensor noise (2,2) of the centre of the points z (k,2) in the map, R (2k,2k), and the centre (2,) itself."""
    k = z.shape[0]
    B, centre = np.empty((2, 2 * k)), part[1:3].copy()
    for i in range(k):
        c, s = math.cos(part[0] + z[i, 1]) / k, math.sin(part[0] + z[i, 1]) / k
        B[0, 2 * i], B[0, 2 * i + 1] = c, -z[i, 0] * s
        B[1, 2 * i], B[1, 2 * i + 1] = s, z[i, 0] * c
        centre[0] += z[i, 0] * c
        centre[1] += z[i, 0] * s
    noise = np.empty((2, 2))
    for r in range(2):
        for c_ in range(2):
            noise[r, c_] = quadratic(R, B[r], B[c_])
    return noise, centre


@compiled
def quadratic(M: Array, a: Array, b: Array) -> float:
    """a^T M b"""
    total = 0.0
    for i in range(a.shape[0]):
        part = 0.0
        for j in range(b.shape[0]):
            part += M[i, j] * b[j]
        total += a[i] * part
    return total
