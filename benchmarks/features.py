"""Corners of single scans against the truth: precision, recall, error, calibration, cost, clustering thresholds.

Random poses in the free space of every shipped layout. A corner is right when a true corner that is visible from the
pose lies within 0.25 m, is convex or concave like it, and its faces look the same way; pairs are one to one. A true
corner is detectable when both its faces are at least 0.35 m long and at least 5 beams of one sweep and 0.3 m of a face
beside it are visible.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mecp_env.slam.clustering import cluster_beams
from mecp_env.slam.config import ClusteringConfig, SensorModel, SlamConfig
from mecp_env.slam.corners import extract_corners
from mecp_env.slam.data import CornerKind, Corners, Scan
from mecp_env.slam.geometry import polar_to_points, to_robot
from mecp_env.slam.linalg import mahalanobis
from mecp_env.slam.segments import extract_segments
from mecp_env.slam.sweeps import merge_sweeps
from mecp_env.world.config import LaserConfig
from mecp_env.world.laser import Laser
from mecp_env.world.layout import load_layout, shipped_layouts
from mecp_env.world.outline import Outline, build_outline, random_free_pose

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

PRESETS = (("paper", 4), ("paper", 1), ("lms200", 4), ("lms200", 1), ("ideal", 4), ("ideal", 1))
THRESHOLDS = ("adaptive_noise", "adaptive", "fixed_0.1", "fixed_0.2", "fixed_0.3", "fixed_0.4", "fixed_0.5")
RANGE_BINS_M = (0.0, 2.0, 4.0, 8.0, 30.0)
NEAR_M, SIGNATURE_RAD = 0.25, math.radians(40.0)
FACE_M, SEEN_M, SEEN_BEAMS = 0.35, 0.3, 5
CLEARANCE_M = 0.3
RESAMPLES = 1000


@dataclass(frozen=True, slots=True)
class Truth:
    """The true corners visible from one pose, in the robot's frame."""

    p_robot: Array  # (n,2) m
    convex: Bools  # (n,)
    normals: Array  # (n,2) rad
    detectable: Bools  # (n,)


@dataclass(frozen=True, slots=True)
class Place:
    """One pose of one layout, what can be seen from it, and a scan for every preset."""

    layout: str
    truth: Truth
    scans: dict[tuple[str, int], Scan]


@dataclass(frozen=True, slots=True)
class Tally:
    """The score of one scan."""

    rows: Array  # (n,6) kind, convex, range m, error m, NIS, right: one row a corner
    visible: tuple[int, int]  # true corners: detectable, the rest
    found: tuple[int, int]  # of them
    seconds: Array  # (4,) of the four stages


def run(args: argparse.Namespace) -> dict[str, Any]:
    """The figures of all presets and of the clustering thresholds; `args.quick` takes a tenth of the poses."""
    poses = 8 if getattr(args, "quick", False) else 80
    places = make_places(poses, getattr(args, "seed", 0))
    figures: dict[str, Any] = {"poses": len(places), "layouts": list(shipped_layouts()), "presets": {}, "thresholds": {}}
    for preset, sweeps in PRESETS:
        figures["presets"][f"{preset}_k{sweeps}"] = summary(score_places(places, preset, sweeps, SlamConfig()))
    for name in THRESHOLDS:
        for sweeps in (4, 1):
            config = SlamConfig(clustering=threshold(name))
            figures["thresholds"][f"{name}_k{sweeps}"] = summary(score_places(places, "paper", sweeps, config))
    return figures


def threshold(name: str) -> ClusteringConfig:
    """The clustering that an entry of THRESHOLDS names."""
    if name.startswith("fixed_"):
        return ClusteringConfig(threshold="fixed", fixed_m=float(name.removeprefix("fixed_")))
    return ClusteringConfig.parse({"threshold": name})


def make_places(poses: int, seed: int) -> list[Place]:
    """`poses` random places in each shipped layout."""
    places = []
    for index, name in enumerate(shipped_layouts()):
        outline = build_outline(load_layout(name))
        lasers = {key: Laser(outline, LaserConfig(preset=key[0], sweeps=key[1])) for key in PRESETS}  # type: ignore[arg-type]
        for number in range(poses):
            rng = np.random.default_rng((seed, index, number))
            pose = random_free_pose(outline, rng, CLEARANCE_M)
            scans = {key: laser.scan(pose, rng) for key, laser in lasers.items()}
            places.append(Place(name, truth_at(outline, lasers["paper", 4], pose), scans))
    return places


def truth_at(outline: Outline, laser: Laser, T_world_robot: Array) -> Truth:
    """The true corners that are visible from a pose."""
    corners = outline.corners
    seen = laser.visible(corners.p_world, T_world_robot)
    step = 2.0 * math.pi / laser.config.beams
    detectable = [
        min(corners.faces[i]) >= FACE_M and any(face_seen(f, i, outline, laser, T_world_robot, step) for f in (0, 1))
        for i in np.flatnonzero(seen)
    ]
    normals = corners.normals[seen] - T_world_robot[2]
    return Truth(
        to_robot(T_world_robot, corners.p_world[seen]),
        corners.convex[seen],
        normals,
        np.array(detectable, dtype=np.bool_).reshape(-1),
    )


def face_seen(side: int, corner: int, outline: Outline, laser: Laser, T_world_robot: Array, step: float) -> bool:
    """True when 0.3 m and 5 beams of the face before (0) or after (1) the corner are visible, from the corner on."""
    p = outline.corners.p_world[corner]
    normal, length = outline.corners.normals[corner, side], outline.corners.faces[corner, side]
    along = np.array([-math.sin(normal), math.cos(normal)]) * (1.0 if side == 0 else -1.0)  # free space on the left
    facing = (T_world_robot[:2] - p) @ np.array([math.cos(normal), math.sin(normal)])
    if facing <= 0.0:
        return False
    distances = np.arange(0.02, min(length, 6.0), 0.04)
    points = p + distances[:, None] * along + 1e-4 * np.array([math.cos(normal), math.sin(normal)])
    hidden = np.flatnonzero(~laser.visible(points, T_world_robot))
    run = distances[: hidden[0]] if len(hidden) else distances
    if len(run) == 0 or run[-1] < SEEN_M - 0.03:
        return False
    a, b = p - T_world_robot[:2], p + run[-1] * along - T_world_robot[:2]
    return abs(math.atan2(a[0] * b[1] - a[1] * b[0], a @ b)) >= SEEN_BEAMS * step


def front_end(scan: Scan, config: SlamConfig) -> tuple[Corners, Array]:
    """The corners of a scan and the seconds (4,) of the stages."""
    clock = [time.perf_counter()]
    beams = merge_sweeps(scan, config.sensor)
    clock.append(time.perf_counter())
    clusters = cluster_beams(beams, config.clustering, config.sensor)
    clock.append(time.perf_counter())
    segments = extract_segments(beams, clusters, config.segments, config.sensor)
    clock.append(time.perf_counter())
    corners = extract_corners(beams, segments, config.corners, config.sensor)
    clock.append(time.perf_counter())
    return corners, np.diff(clock)


def score_places(places: Sequence[Place], preset: str, sweeps: int, config: SlamConfig) -> list[Tally]:
    """The score of the scans of one preset."""
    laser = LaserConfig.parse({"preset": preset, "sweeps": sweeps})
    sensor = SensorModel(range_sigma_m=laser.range_sigma_m, bearing_sigma_deg=laser.bearing_sigma_deg)
    config = config.model_copy(update={"sensor": sensor})
    return [score(place.truth, *front_end(place.scans[preset, sweeps], config)) for place in places]


def score(truth: Truth, corners: Corners, seconds: Array) -> Tally:
    """Compares the corners of a scan with the truth."""
    partner = pair(truth, corners)
    R, rows = corners.R, np.full((len(corners), 6), np.nan)
    points = polar_to_points(corners.z)
    for i, j in enumerate(partner):
        rows[i, :3] = corners.kind[i], corners.convex[i], corners.z[i, 0]
        rows[i, 5] = j >= 0
        if j >= 0:
            p = truth.p_robot[j]
            turn = math.remainder(corners.z[i, 1] - math.atan2(p[1], p[0]), 2.0 * math.pi)
            nu = np.array([corners.z[i, 0] - math.hypot(*p), turn])
            rows[i, 3:5] = math.dist(points[i], p), mahalanobis(nu, np.ascontiguousarray(R[i]))
    hit = np.isin(np.arange(len(truth.convex)), partner)
    easy = truth.detectable
    return Tally(rows, (int(easy.sum()), int((~easy).sum())), (int(hit[easy].sum()), int(hit[~easy].sum())), seconds)


def pair(truth: Truth, corners: Corners) -> list[int]:
    """The true corner of each corner, nearest pairs first, or -1."""
    partner = [-1] * len(corners)
    if len(corners) == 0 or len(truth.convex) == 0:
        return partner
    points = polar_to_points(corners.z)
    distance = np.hypot(*(points[:, None, :] - truth.p_robot[None, :, :]).transpose(2, 0, 1))
    turn = np.abs(np.remainder(corners.normals[:, None] - truth.normals[None] + math.pi, 2.0 * math.pi) - math.pi)
    alike = (np.isnan(turn) | (turn < SIGNATURE_RAD)).all(axis=2) & (corners.convex[:, None] == truth.convex[None])
    distance[~alike | (distance > NEAR_M)] = np.inf
    while np.isfinite(distance).any():
        i, j = np.unravel_index(np.argmin(distance), distance.shape)
        partner[i] = int(j)
        distance[i, :] = distance[:, j] = np.inf
    return partner


def summary(tallies: Sequence[Tally]) -> dict[str, Any]:
    """The figures of one preset: rates with 95 % intervals (bootstrap over poses), NIS by kind and range, times."""
    rows = [t.rows for t in tallies]
    figures: dict[str, Any] = {
        "corners": sum(len(r) for r in rows),
        "precision": rate([r[:, 5].sum() for r in rows], [len(r) for r in rows]),
        "recall_detectable": rate([t.found[0] for t in tallies], [t.visible[0] for t in tallies]),
        "recall_rest": rate([t.found[1] for t in tallies], [t.visible[1] for t in tallies]),
        "nis": rate([np.nansum(r[:, 4]) for r in rows], [r[:, 5].sum() for r in rows]),
    }
    every = np.concatenate(rows)
    right = every[every[:, 5] == 1.0]
    figures["rms_error_m"] = float(np.sqrt(np.mean(right[:, 3] ** 2))) if len(right) else math.nan
    figures["nis_over_13.8"] = float(np.mean(right[:, 4] > 13.82)) if len(right) else math.nan
    figures["nis_by_kind_and_range"] = nis_table(right)
    figures["microseconds"] = [float(m) for m in 1e6 * np.median([t.seconds for t in tallies], axis=0)]
    figures["microseconds_total"] = float(1e6 * np.median([t.seconds.sum() for t in tallies]))
    return figures


def rate(parts: Sequence[float], wholes: Sequence[float]) -> list[float]:
    """Sum of parts over sum of wholes, with its 95 % interval over resampled poses."""
    part, whole = np.asarray(parts, dtype=np.float64), np.asarray(wholes, dtype=np.float64)
    if whole.sum() == 0.0:
        return [math.nan] * 3
    draws = np.random.default_rng(0).integers(len(part), size=(RESAMPLES, len(part)))
    rates = part[draws].sum(axis=1) / np.maximum(whole[draws].sum(axis=1), 1.0)
    return [float(part.sum() / whole.sum()), *(float(q) for q in np.quantile(rates, (0.025, 0.975)))]


def nis_table(right: Array) -> dict[str, list[list[float]]]:
    """For each kind: [mean NIS, corners] in each bin of RANGE_BINS_M."""
    kinds: dict[str, Callable[[Array], Bools]] = {
        "concave": lambda r: (r[:, 0] == CornerKind.CROSSING) & (r[:, 1] == 0.0),
        "convex": lambda r: (r[:, 0] == CornerKind.CROSSING) & (r[:, 1] == 1.0),
        "free_end": lambda r: r[:, 0] == CornerKind.FREE_END,
        "jamb": lambda r: r[:, 0] == CornerKind.JAMB,
    }
    return {name: [bin_of(right[select(right)], k) for k in range(len(RANGE_BINS_M) - 1)] for name, select in kinds.items()}


def bin_of(rows: Array, k: int) -> list[float]:
    """[mean NIS, corners] of the k-th bin of range."""
    nis = rows[(rows[:, 2] >= RANGE_BINS_M[k]) & (rows[:, 2] < RANGE_BINS_M[k + 1]), 4]
    return [float(nis.mean()) if len(nis) else math.nan, len(nis)]
