"""The surfaces that a scan shows: points with the normals of what they are on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mecp_env.core.array_types import Array, Bools, Ints
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import to_map
from mecp_env.slam.config import SensorModel
from mecp_env.slam.messages import MergedScan, Segments


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """Points on surfaces, in the frame of a laser."""

    points: Array  # (n,2) m
    normals: Array  # (n,2) of length 1, towards the laser; 0 for a point on no flat surface
    sigmas: Array  # (n,) m, of a point along its normal, or in any direction

    def seen_from(self, T_a_b: Array) -> Surfaces:
        """The same surfaces, of frame b, in frame a; T_a_b (3,)."""
        turn = np.array([0.0, 0.0, T_a_b[2]])
        return replace(self, points=to_map(T_a_b, self.points), normals=to_map(turn, self.normals))

    @property
    def plain(self) -> tuple[Array, Array, Array]:
        """The fields, as the compiled functions take them."""
        return self.points, self.normals, self.sigmas

    def flat(self) -> Surfaces:
        """Those on flat surfaces."""
        on = self.normals.any(axis=1)
        return Surfaces(self.points[on], self.normals[on], self.sigmas[on])

    def __len__(self) -> int:
        return len(self.points)


def surfaces_of(beams: MergedScan, segments: Segments, wall: Bools, sensor: SensorModel) -> Surfaces:
    """The points where the beams that `wall` (B,) names end, with the normals of the segments that they are on.

    A normal fitted to a few beams is too noisy: along a corridor, thousands of them tell a motion that nobody made.
    """
    scan = beams.ranges, beams.bearings, beams.hit & wall, beams.hit, beams.count
    lines = segments.line, segments.first, segments.last, segments.roll
    least_m = max(sensor.range_sigma_m, sensor.least_range_sigma_m)
    noise = float(least_m), float(sensor.range_sigma_share), float(sensor.noise_sigmas)
    return Surfaces(*_surfaces(scan, lines, noise))


@compiled
def _surfaces(
    scan: tuple[Array, Array, Bools, Bools, Ints],
    lines: tuple[Array, Ints, Ints, int],
    noise: tuple[float, float, float],
) -> tuple[Array, Array, Array]:
    """See `surfaces_of`: points, normals and sigmas; the third of `scan` are the hits that are on a wall.

    `noise`: the least standard deviation of a raw range (m), the share of the range, the number of standard deviations.
    """
    (ranges, bearings, solid, hit, count), (line, first, last, roll) = scan, lines
    size, (least_m, of_range, sigmas_apart) = ranges.shape[0], noise
    points, normals, sigmas, n = np.empty((size, 2)), np.zeros((size, 2)), np.empty(size), 0
    for i in range(line.shape[0]):
        for position in range(first[i], last[i] + 1):
            beam = (roll + position) % size
            normals[beam, 0], normals[beam, 1] = -math.cos(line[i, 0]), -math.sin(line[i, 0])
    for beam in range(size):
        flat = normals[beam, 0] != 0.0 or normals[beam, 1] != 0.0
        if not (solid[beam] or (hit[beam] and flat)):
            continue
        points[n, 0], points[n, 1] = ranges[beam] * math.cos(bearings[beam]), ranges[beam] * math.sin(bearings[beam])
        normals[n, 0], normals[n, 1] = normals[beam, 0], normals[beam, 1]
        sigma = max(least_m, of_range * ranges[beam]) / math.sqrt(max(count[beam], 1))
        sigmas[n] = sigma if flat else sigmas_apart * sigma  # another scan may have hit the same thing beside it
        n += 1
    return points[:n].copy(), normals[:n].copy(), sigmas[:n].copy()


def joined_surfaces(parts: Sequence[Surfaces]) -> Surfaces:
    """All surfaces of at least one part, in one frame."""
    points, normals, sigmas = zip(*((part.points, part.normals, part.sigmas) for part in parts), strict=True)
    return Surfaces(np.concatenate(points), np.concatenate(normals), np.concatenate(sigmas))
