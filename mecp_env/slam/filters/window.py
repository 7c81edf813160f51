"""What association asks of a filter: how measurements fit the joint Gaussian of the pose and of some landmarks.

They are written once, for every filter: one that gives its window has them all.

The one place where a filter that diverges is noticed.
"""

from __future__ import annotations

import logging
import math
from abc import abstractmethod
from dataclasses import dataclass
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.jit import compiled
from mecp_env.core.linalg import block_of, factor_lower, forward_rows, quadratic, solve_lower
from mecp_env.core.se2 import polar_to_points, wrap_angle
from mecp_env.slam.filters.models import (
    change_chart,
    innovation,
    innovation_cov,
    left_jacobian,
    linearise,
    project,
    residual,
)
from mecp_env.slam.filters.update import gauss_newton, take, world_belief
from mecp_env.slam.messages import NO_ID, Belief, find_rows
from mecp_env.slam.protocols import AnswerError, Filter, FilterError

log = logging.getLogger(__name__)

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
    """Twice the log of p(z | pose noise is larger by `noise`) / p(z | as it is); nan: not positive, or an unknown id.

    `noise` (3,3) of x, y, heading, positive. S of the larger noise is S + E E^T, E = D C with the derivative D of z by
    the pose and noise = C C^T: of z, whitened by S, only the three components along the columns of E tell.
    """
    m = ids.shape[0]
    slots, h, A, a_heading = np.empty(m, np.int64), np.empty((m, 2)), np.empty((m, 2, 2)), np.empty((m, 2))
    if not find_rows(slot_ids, ids, slots):
        return math.nan
    part, own = take(state, slots), np.arange(m)
    size, nu, S, E = part.shape[1], np.empty(2 * m), np.empty((2 * m, 2 * m)), np.empty((2 * m, 3))
    linearise(part[0], own, invariant, h, A, a_heading)
    residual(z, h, A, a_heading, own, np.zeros(size), nu)
    innovation_cov(project(part[1:], size, A, a_heading, own), A, a_heading, own, R, S)
    C, M, g, factor = noise.copy(), np.eye(3), np.zeros(3), 0.0
    if not (factor_lower(S) and factor_lower(C)):
        return math.nan
    for k in range(m):
        for r in range(2):
            x, y, heading = -A[k, r, 0], -A[k, r, 1], -1.0 * r
            E[2 * k + r, 0] = x * C[0, 0] + y * C[1, 0] + heading * C[2, 0]
            E[2 * k + r, 1] = y * C[1, 1] + heading * C[2, 1]
            E[2 * k + r, 2] = heading * C[2, 2]
    forward_rows(S, E)
    white = solve_lower(S, nu)
    for a in range(3):
        for i in range(2 * m):
            g[a] += E[i, a] * white[i]
            for b in range(a + 1):
                M[a, b] += E[i, a] * E[i, b]
    factor_lower(M)
    gain = solve_lower(M, g)
    for a in range(3):
        factor += gain[a] * gain[a] - 2.0 * math.log(M[a, a])
    return factor


@compiled
def procrustes(part: Array, z: Array, invariant: bool, xi: Array) -> None:
    """Write to xi the error of the pose that lays the measured points best (least squares) on the landmarks.

    `part` is the mean of pose and landmarks; every landmark stays where it is.
    """
    m = z.shape[0]
    points, mx, my, lx, ly = polar_to_points(z), 0.0, 0.0, 0.0, 0.0
    for k in range(m):
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
        failed = isinstance(error, FilterError) and not isinstance(error, AnswerError)
        if failed and not self.found:
            log.warning("mecp_env: the filter diverged: %s", error)
        self.found |= failed
        return failed


class Window(NamedTuple):
    """The joint Gaussian of the pose and of some landmarks: heading, x, y, l1x, l1y, ..."""

    state: Array  # (1+C,C) the mean in its first row, below it the covariance of its error; the first 3 + 2m count
    slot_ids: Ints  # (m,) ids of the landmarks, in the order of the state; more than were asked for may be there
    invariant: bool  # the error acts on pose and landmarks alike (`error_state`); False: it is added to the mean


class WindowFilter(Filter):
    """Base of every filter, and of a filter of your own, which must have `window` and what is abstract in `Filter`.

    Shapes, units and errors are those described there.
    """

    slot_ids: Ints  # (N,) ids in the order of the state; those below -1 are marks of past poses
    dropped: int = 0  # landmarks that found no room
    update_iterations: int = 1  # of the iterated joint test

    @property
    def ids(self) -> Ints:
        """(N,) ids of the landmarks in the order of their initialisation."""
        return self.slot_ids[self.slot_ids > NO_ID]

    def has(self, landmark: int) -> bool:
        """True when the filter holds a landmark, or a mark of a past pose, with this id."""
        return bool((self.slot_ids == landmark).any())

    def checked_window(self, ids: Ints, apart: bool = False) -> Window:
        """`window`, as the compiled functions take it. Raises `FilterError` unless its parts fit each other."""
        return check_window(self.window(ids, apart))

    @abstractmethod
    def window(self, ids: Ints, apart: bool = False) -> Window:
        """The Gaussian of the pose and at least the landmarks `ids` (m,); it is read, and not kept.

        `apart`: the covariance of one landmark with another may be missing. Raises `FilterError` for an unknown id, or
        leaves it out.
        """

    def belief(self) -> Belief:
        """Pose and landmarks with their own covariances, in world coordinates, without marks of past poses; a copy."""
        return belief_of(self.checked_window(self.ids))

    def marginal(self, ids: Ints) -> tuple[Array, Array]:
        """Mean (3+2m,) x, y, heading, landmarks and covariance (3+2m,3+2m), world coordinates."""
        state, slot_ids, invariant = self.checked_window(ids)
        part = take(state, slots_of(slot_ids, ids))
        size = part.shape[1]
        change_chart(part, size, 1.0, invariant)
        order = np.arange(size)
        order[:3] = 1, 2, 0
        return part[0, order], block_of(part[1:], order, order)

    def innovation(self, z: Array, R: Array, ids: Ints) -> tuple[Array, Array]:
        """nu (2n,) and S (2n,2n) of the pairs z[i] - ids[i]; z (n,2), R (2n,2n), ids (n,)."""
        z, R, ids = observations(z, R, ids)
        size, (state, slot_ids, invariant) = 2 * len(ids), self.checked_window(ids)
        nu, S = np.empty(size), np.empty((size, size))
        if not innovation(state, slot_ids, ids, z, R, invariant, nu, S):
            slots_of(slot_ids, ids)
        return nu, S

    def individual_nis(self, z: Array, R: Array, ids: Ints) -> Array:
        """NIS (n,m) of every z (n,2), R (n,2,2) against every id (m,); inf where absurdly far."""
        z, R, ids = as_floats(z), as_floats(R), integers(ids)
        nis, (state, slot_ids, invariant) = np.empty((len(z), len(ids))), self.checked_window(ids, apart=True)
        if not pairwise_nis(state, slot_ids, ids, z, R, invariant, nis):
            slots_of(slot_ids, ids)
        return nis

    def joint_nis(self, z: Array, R: Array, ids: Ints, iterate: bool = False) -> float:
        """Least cost (prior + residuals, 2n degrees of freedom) of the pairs over pose and map (derivations 3.2)."""
        z, R, ids = observations(z, R, ids)
        window = self.checked_window(ids)
        steps = self.update_iterations if iterate else 1
        nis = joint_cost(window.state, window.slot_ids, ids, z, R, window.invariant, steps)
        return finite(nis, "joint_nis", window, ids)

    def log_bayes_factor(self, z: Array, R: Array, ids: Ints, pose_cov: Array) -> float:
        """Twice the log of how much likelier the pairs are with a covariance (3,3) of x, y, heading more."""
        z, R, ids = observations(z, R, ids)
        window = self.checked_window(ids)
        factor = log_bayes_factor(window.state, window.slot_ids, ids, z, R, window.invariant, as_floats(pose_cov))
        return finite(factor, "log_bayes_factor", window, ids)

    def mean_of_gaussians_nis(self, z: Array, R: Array, ids: Ints, paper_S: bool = False) -> float:
        """NIS (2 degrees of freedom) of the centre of the points z (k,2) against the landmarks' (III-B.1, eq. 2-3).

        Differs from the paper: S has the cross term of pose and map; `paper_S` leaves it out.
        """
        z, R, ids = observations(z, R, ids)
        window = self.checked_window(ids)
        nis = centre_nis(window.state, window.slot_ids, ids, z, R, window.invariant, paper_S)
        return finite(nis, "mean_of_gaussians_nis", window, ids)


def check_window(window: Any) -> Window:
    """A window of contiguous arrays of float64 and int64. Raises `FilterError` unless these fit each other."""
    if not isinstance(window, tuple) or len(window) != len(Window._fields):
        raise FilterError(f"window: {type(window).__name__}, a Window expected")
    try:
        state, slot_ids = as_floats(window[0]), integers(window[1])
    except (TypeError, ValueError) as error:
        raise FilterError(f"window: {error}") from None
    size = 3 + 2 * slot_ids.size
    if slot_ids.ndim != 1 or state.ndim != 2 or state.shape[0] <= size or state.shape[1] < size:
        raise FilterError(f"window: state {state.shape} for slot_ids {slot_ids.shape}, {(1 + size, size)} expected")
    return Window(state, slot_ids, bool(window[2]))


def belief_of(window: Window) -> Belief:
    """Pose and landmarks of a window in world coordinates, without marks of past poses."""
    state, slot_ids, invariant = window
    pose, pose_cov, count = np.empty(3), np.empty((3, 3)), len(slot_ids)
    p_map, covs = np.empty((count, 2)), np.empty((count, 2, 2))
    if world_belief(state, slot_ids, invariant, pose, pose_cov, p_map, covs):
        kept = slot_ids > NO_ID
        return Belief(pose, pose_cov, slot_ids[kept], p_map[kept], covs[kept])
    return Belief(pose, pose_cov, slot_ids.copy(), p_map, covs)


def finite(result: float, name: str, window: Window, ids: Ints) -> float:
    """The result of a test. Raises `FilterError` where it is nan: an unknown id, or S is not positive."""
    if math.isnan(result):
        slots_of(window.slot_ids, ids)
        raise FilterError(f"{name}: innovation covariance is not positive")
    return result


def slots_of(slot_ids: Ints, ids: Ints) -> Ints:
    """(m,) the slot of each of the `ids` (m,). Raises `FilterError` for an unknown one."""
    ids = integers(ids)
    slots = np.empty(len(ids), np.int64)
    if not find_rows(slot_ids, ids, slots):
        raise FilterError(f"ids {ids[slots < 0].tolist()} are no landmarks of this filter")
    return slots


def as_floats(values: Array) -> Array:
    """An array as the compiled functions take it."""
    return np.ascontiguousarray(values, np.float64)


def integers(values: Ints) -> Ints:
    """An array as the compiled functions take it."""
    return np.ascontiguousarray(values, np.int64)


def observations(z: Array, R: Array, ids: Ints) -> tuple[Array, Array, Ints]:
    """The same as the compiled functions take them. Raises `FilterError` for shapes that do not fit."""
    z, R, ids, n = as_floats(z), as_floats(R), integers(ids), len(ids)
    if z.shape != (n, 2) or R.shape != (2 * n, 2 * n):
        raise FilterError(f"z {z.shape} and R {R.shape} do not fit {n} ids: expected ({n}, 2) and ({2 * n}, {2 * n})")
    return z, R, ids
