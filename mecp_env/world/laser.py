"""The laser: a true pose -> a noisy burst of sweeps, by rays cast against the faces of the outline (IV)."""

from __future__ import annotations

import math
import sys
from functools import cache
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.carriers import Array, Bools
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import compose
from mecp_env.core.sensors import Scan
from mecp_env.world.config import LaserConfig
from mecp_env.world.outline import Outline

Draws = NDArray[np.uint16]
Normals = NDArray[np.float32]

CUT_SIGMAS = 4.0  # noise is truncated there: a face is tested by its own beams and those within this many sigmas of it
QUANTILES = 65_536
ON_FACE_M = 1e-6  # a point this near to a face is on it
SEEN_M = 1e-3  # a point is visible when nothing is more than this in front of it
MIN_RANGE_M = 1e-3


class Laser:
    """A laser in the world of `outline`: K sweeps of B beams with interleaved bearings, all at one pose.

    Beam i of sweep k has the nominal bearing -V / 2 + (i K + k + 1) V / (K B) for a field of view V: the bearings of
    each sweep ascend in (-pi, pi], and `bearings.T.ravel()` is the whole burst in order. Which walls are dark follows
    from `dark_seed`.
    """

    def __init__(self, outline: Outline, config: LaserConfig, dark_seed: int = 0) -> None:
        self.config = config
        self._segments = np.ascontiguousarray(outline.segments)
        rays = config.sweeps * config.beams
        view = config.field_of_view_rad
        ring = -0.5 * view + view / rays * np.arange(1, rays + 1)
        ring[-1] = 0.5 * view
        self._table = np.stack([np.cos(ring), np.sin(ring)])
        self._bearings = np.ascontiguousarray(ring.reshape(config.beams, config.sweeps).T)  # shared by all scans
        self._normals = _normal_quantiles()
        noise = config.bearing_sigma_rad, config.range_sigma_m, config.range_sigma_share
        self._rows = 3 if config.has_dark_walls else 2 if any(noise) else 0  # of draws
        self._whole_words = sys.byteorder == "little" and self._rows * rays % 4 == 0  # they fill words of 64 bits
        least_cosine = math.cos(math.radians(config.grazing_deg))
        self._optics = np.array([*noise, config.max_range_m, float(config.sweeps), view, least_cosine])
        dark = np.random.default_rng(dark_seed).random(len(self._segments)) < config.dark_share
        self._dropout = np.where(dark, config.dark_dropout, 0.0) if config.loses_beams else np.empty(0)  # share by face
        self._T_robot_laser = config.T_robot_laser

    def scan(self, T_world_robot: Array, rng: np.random.Generator, faces: Array | None = None) -> Scan:
        """A burst taken at the robot's true pose (3,), noise from `rng`; beside walls it sees the faces (m,2,2)."""
        draws, segments, dropout = self._draw(rng), self._segments, self._dropout
        if faces is not None and len(faces):
            segments = np.concatenate([segments, faces])
            if len(dropout):  # pedestrians are not dark
                dropout = np.concatenate([dropout, np.zeros(len(faces))])
        T_world_laser = compose(T_world_robot, self._T_robot_laser)
        ranges, hit = _burst(segments, T_world_laser, self._table, draws, self._normals, self._optics, dropout)
        return Scan(ranges, self._bearings, hit, self.config.max_range_m)

    def visible(self, p_world: Array, T_world_robot: Array) -> Bools:
        """Which points (n,2) have a free line of sight to the laser of the robot at (3,), all around, at any range."""
        points = np.ascontiguousarray(p_world, dtype=np.float64).reshape(-1, 2)
        x, y, _ = compose(T_world_robot, self._T_robot_laser).tolist()
        return line_of_sight(self._segments, x, y, points)

    def _draw(self, rng: np.random.Generator) -> Draws:
        """Quantiles (2 or 3,N) of the noise of bearings and ranges, and of what dark walls swallow; else none drawn."""
        shape, bits = (self._rows, self._table.shape[1]), rng.bit_generator
        if self._rows == 0:
            return np.zeros(self._table.shape, dtype=np.uint16)
        if self._whole_words and isinstance(bits, np.random.PCG64):  # as below, but three times as fast
            words: NDArray[np.uint64] = bits.random_raw(shape[0] * shape[1] // 4)
            return words.view(np.uint16).reshape(shape)
        return rng.integers(QUANTILES, size=shape, dtype=np.uint16)


@cache
def _normal_quantiles() -> Normals:
    """The upper half of the standard normal in 65,536 equally likely values, cut at 4 sigma.

    Cheaper than `standard_normal`, and half of it stays in the processor's cache.
    """
    quantile = NormalDist().inv_cdf
    values = np.array([quantile((i + 0.5) / QUANTILES) for i in range(QUANTILES // 2, QUANTILES)], dtype=np.float32)
    return np.minimum(values, CUT_SIGMAS)


@compiled
def _burst(
    segments: Array,
    T_world_laser: Array,
    table: Array,
    draws: Draws,
    normals: Normals,
    optics: Array,
    dropout: Array,
) -> tuple[Array, Bools]:
    """Ranges and hits (K,B) of a burst with the noise drawn (2,N) along the nominal directions (2,N).

    `optics` (7,) holds the sigmas of bearings and ranges, the least share of the range that the latter is, the largest
    range, K, the field of view, and the least cosine of the incidence. Of a face with a `dropout` that share of the
    beams does not return; none is lost where it is empty.
    """
    bearing_sigma, range_sigma, share, max_range, sweeps = optics[0], optics[1], optics[2], optics[3], int(optics[4])
    directions = table
    if bearing_sigma > 0.0:  # turn the rays
        directions, errors = np.empty_like(table), np.empty(table.shape[1])
        for i in range(table.shape[1]):
            errors[i] = bearing_sigma * _normal(normals, draws[0, i])
        for i in range(table.shape[1]):
            e = errors[i]
            q = e * e
            c = 1.0 - q / 2.0 * (1.0 - q / 12.0 * (1.0 - q / 30.0))
            s = e * (1.0 - q / 6.0 * (1.0 - q / 20.0 * (1.0 - q / 42.0)))
            directions[0, i] = c * table[0, i] - s * table[1, i]
            directions[1, i] = s * table[0, i] + c * table[1, i]
    inverse = _cast(segments, T_world_laser, directions, optics[5], CUT_SIGMAS * bearing_sigma)
    c, s = math.cos(T_world_laser[2]), math.sin(T_world_laser[2])
    for k in range(dropout.shape[0]):  # the rays that end on this face
        x, y = segments[k, 0, 0] - T_world_laser[0], segments[k, 0, 1] - T_world_laser[1]
        u, v = segments[k, 1, 0] - segments[k, 0, 0], segments[k, 1, 1] - segments[k, 0, 1]
        length = math.hypot(u, v)
        distance = (x * v - y * u) / length  # of the face's line
        ux, uy, along = (c * u + s * v) / length, (c * v - s * u) / length, (x * u + y * v) / length
        if distance <= ON_FACE_M:
            continue
        for i in range(table.shape[1]):
            cosine = directions[0, i] * uy - directions[1, i] * ux  # of the incidence
            if inverse[i] <= 0.0 or abs(cosine - distance * inverse[i]) > ON_FACE_M * inverse[i]:
                continue
            place = (directions[0, i] * ux + directions[1, i] * uy) / inverse[i] - along
            lost = cosine < optics[6] or (dropout[k] > 0.0 and draws[2, i] < dropout[k] * QUANTILES)
            if lost and -ON_FACE_M <= place <= length + ON_FACE_M:
                inverse[i] = 0.0
    beams = table.shape[1] // sweeps
    ranges, hit = np.full((sweeps, beams), max_range), np.zeros((sweeps, beams), np.bool_)
    for k in range(sweeps):
        for j in range(beams):
            i = j * sweeps + k  # the order of the ring
            if inverse[i] * max_range <= 1.0:
                continue
            r = 1.0 / inverse[i]
            measured = r + max(range_sigma, share * r) * _normal(normals, draws[1, i])
            if measured < max_range:
                ranges[k, j], hit[k, j] = max(measured, MIN_RANGE_M), True
    return ranges, hit


@compiled
def _normal(normals: Normals, draw: int) -> float:
    """The quantile of number `draw` of the whole normal, by its upper half; without a branch: it would be a guess."""
    upper = np.int64(draw) >> 15
    return float((2 * upper - 1) * normals[(draw ^ (upper - 1)) & 32_767])


@compiled
def _cast(segments: Array, T_world_laser: Array, directions: Array, view: float, margin: float) -> Array:
    """Inverse range (N,) along each ray, 0 where no face is met.

    Ray i is nominally at the bearing -view / 2 + (i + 1) view / N and may be off by `margin`. A face is looked at only
    by the rays between its ends, widened by the margin; faces seen from behind are left out. On the face from a to b
    the inverse range along d is linear in d, (u x d) / (a x b) with u = b - a negated: the nearest face is a maximum.
    """
    c, s = math.cos(T_world_laser[2]), math.sin(T_world_laser[2])
    n = directions.shape[1]
    inverse, face = np.zeros(n), np.empty(6)
    slack, spacing = margin + 1e-9, view / n
    for k in range(segments.shape[0]):
        x, y = segments[k, 0, 0] - T_world_laser[0], segments[k, 0, 1] - T_world_laser[1]
        face[0], face[1] = c * x + s * y, c * y - s * x
        x, y = segments[k, 1, 0] - T_world_laser[0], segments[k, 1, 1] - T_world_laser[1]
        face[2], face[3] = c * x + s * y, c * y - s * x
        area = face[0] * face[3] - face[1] * face[2]
        if area < 1e-12:
            continue
        face[4], face[5] = (face[3] - face[1]) / area, (face[0] - face[2]) / area
        start = math.atan2(face[1], face[0]) + 0.5 * view  # from the right end of the view
        end = start + math.atan2(area, face[0] * face[2] + face[1] * face[3])
        if start - slack + 2.0 * math.pi <= view:
            start, end = start + 2.0 * math.pi, end + 2.0 * math.pi
        while end + slack >= spacing:  # once, and again where the face goes on behind the robot into the view
            outer = max(math.ceil((start - slack) / spacing) - 1, 0)
            inner = max(math.ceil((start + slack) / spacing) - 1, 0)
            last_inner = min(math.floor((end - slack) / spacing) - 1, n - 1)
            last_outer = min(math.floor((end + slack) / spacing) - 1, n - 1)
            if last_inner < inner:
                _meet_end(inverse, directions, face, outer, last_outer)
            else:
                _meet_end(inverse, directions, face, outer, inner - 1)  # the rays inner..last_inner surely meet it
                stop = last_inner + 1
                _look(inverse[inner:stop], directions[0, inner:], directions[1, inner:], face[4], face[5])
                _meet_end(inverse, directions, face, stop, last_outer)
            start, end = start - 2.0 * math.pi, end - 2.0 * math.pi
    return inverse


@compiled
def _look(inverse: Array, dx: Array, dy: Array, u: float, v: float) -> None:
    """Raise the inverse ranges (n,) to those of the face u, v along the first of the directions dx, dy.

    On parts of the arrays, counted from 0: so the compiler takes four rays at a time.
    """
    for i in range(inverse.shape[0]):
        inverse[i] = max(inverse[i], u * dx[i] + v * dy[i])


@compiled
def _meet_end(inverse: Array, directions: Array, face: Array, first: int, last: int) -> None:
    """Let those of the rays first..last that pass between the face's ends see it."""
    for i in range(first, last + 1):
        dx, dy = directions[0, i], directions[1, i]
        if face[0] * dy - face[1] * dx >= 0.0 and dx * face[3] - dy * face[2] >= 0.0:
            inverse[i] = max(inverse[i], face[4] * dx + face[5] * dy)


@compiled
def line_of_sight(segments: Array, x: float, y: float, points: Array) -> Bools:
    """Which points (n,2) are seen from (x, y): no face (S,2,2) lies more than 1 mm in front of them."""
    seen = np.ones(points.shape[0], np.bool_)
    for i in range(points.shape[0]):
        px, py = points[i, 0] - x, points[i, 1] - y
        allowed = 1.0 - SEEN_M / max(math.sqrt(px * px + py * py), SEEN_M)
        for k in range(segments.shape[0]):
            ax, ay = segments[k, 0, 0] - x, segments[k, 0, 1] - y
            bx, by = segments[k, 1, 0] - x, segments[k, 1, 1] - y
            area = ax * by - ay * bx
            if area <= 0.0 or ax * py - ay * px < 0.0 or px * by - py * bx < 0.0:
                continue
            if area < allowed * ((by - ay) * px - (bx - ax) * py):
                seen[i] = False
                break
    return seen
