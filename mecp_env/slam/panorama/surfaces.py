"""The surfaces that a scan shows: points with the normals of what they are on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mecp_env.core.array_types import Array, Bools
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
    points, sigmas, normals = points_of(beams), range_sigmas(beams, sensor), np.zeros((len(beams.ranges), 2))
    for first, last, (alpha, _) in zip(segments.first, segments.last, segments.line, strict=True):
        normals[(segments.roll + np.arange(first, last + 1)) % len(normals)] = -math.cos(alpha), -math.sin(alpha)
    loose = ~normals.any(axis=1)  # another scan may have hit the same thing beside it
    sigmas[loose] *= sensor.noise_sigmas
    solid = beams.hit & (wall | ~loose)
    return Surfaces(points[solid], normals[solid], sigmas[solid])


def joined_surfaces(parts: Sequence[Surfaces]) -> Surfaces:
    """All surfaces of at least one part, in one frame."""
    points, normals, sigmas = zip(*((part.points, part.normals, part.sigmas) for part in parts), strict=True)
    return Surfaces(np.concatenate(points), np.concatenate(normals), np.concatenate(sigmas))


def points_of(beams: MergedScan) -> Array:
    """(B,2) m, where the beams end."""
    return np.stack((beams.ranges * np.cos(beams.bearings), beams.ranges * np.sin(beams.bearings)), axis=1)


def range_sigmas(beams: MergedScan, sensor: SensorModel) -> Array:
    """(B,) m, of the ranges of merged beams."""
    raw = np.maximum(sensor.range_sigma_m, sensor.range_sigma_share * beams.ranges)
    sigmas: Array = np.maximum(raw, sensor.least_range_sigma_m) / np.sqrt(np.maximum(beams.count, 1))
    return sigmas
