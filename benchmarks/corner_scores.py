"""Compare the corners of single scans with the true corners visible from the pose."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from benchmarks.known_pairs import polar
from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.se2 import polar_to_points, to_robot, wrapped
from mecp_env.core.sensors import Scan
from mecp_env.slam.association.gating import one_to_one
from mecp_env.slam.config import SensorModel, SlamConfig
from mecp_env.slam.frontend.clustering import cluster_beams
from mecp_env.slam.frontend.corners import extract_corners
from mecp_env.slam.frontend.scan import merge_sweeps
from mecp_env.slam.frontend.segments import extract_segments
from mecp_env.slam.messages import Corners, Doorways
from mecp_env.world.config import LaserConfig
from mecp_env.world.laser import Laser
from mecp_env.world.layout import load_layout
from mecp_env.world.outline import Outline, build_outline, random_free_pose

NEAR_M, SIGNATURE_RAD = 0.25, math.radians(40.0)
FACE_M, SEEN_M, SEEN_BEAMS = 0.35, 0.3, 5
SAMPLE_M, FARTHEST_SAMPLE_M = 0.04, 6.0
CLEARANCE_M, DOOR_M = 0.3, 0.3
Preset = tuple[str, int]  # noise of the laser, sweeps


class Truth(NamedTuple):
    """Ground truth visible from one pose, in the robot's frame."""

    p_robot: Array  # (n,2) m, corners in line of sight
    convex: Bools  # (n,)
    normals: Array  # (n,2) rad
    detectable: Bools  # (n,)
    doors: Array  # (d,2) m, centres of all doors
    well_seen: Bools  # (d,) both jambs of this side visible, within 3 m and 30 degrees


class Place(NamedTuple):
    """One pose in one layout, the ground truth visible from it, and a scan for every preset."""

    truth: Truth
    scans: dict[Preset, Scan]


@dataclass(frozen=True, slots=True)
class Score:
    """The score of one scan."""

    rows: list[list[float]]  # kind, convex, range m, error m, NIS, correct: one row per corner
    visible: tuple[int, int]  # true corners: detectable, others
    found: tuple[int, int]  # found among them
    doors: tuple[int, int, int]  # visible doors, found doors, false doors
    seconds: list[float]  # of the four stages

    @property
    def table(self) -> Array:
        """(n,6) the rows."""
        return np.array(self.rows, float).reshape(-1, 6)


def make_places(layout: str, poses: int, seed: int, presets: Sequence[Preset]) -> list[Place]:
    """`poses` random places in a layout, each with a scan for every preset."""
    outline = build_outline(load_layout(layout))
    lasers = {key: Laser(outline, with_noise_of(*key)) for key in presets}
    places = []
    for number in range(poses):
        rng = np.random.default_rng((seed, *layout.encode(), number))
        T_world_robot = random_free_pose(outline, rng, CLEARANCE_M)
        scans = {key: laser.scan(T_world_robot, rng) for key, laser in lasers.items()}
        places.append(Place(truth_at(outline, lasers[presets[0]], T_world_robot), scans))
    return places


def with_noise_of(preset: str, sweeps: int) -> LaserConfig:
    """The laser of the paper, which sees all around, with the noise of a preset."""
    noise = LaserConfig.parse({"preset": preset})
    return LaserConfig(range_sigma_m=noise.range_sigma_m, bearing_sigma_deg=noise.bearing_sigma_deg, sweeps=sweeps)


def truth_at(outline: Outline, laser: Laser, T_world_robot: Array) -> Truth:
    """Ground truth visible from a pose."""
    corners = outline.corners
    seen = laser.visible(corners.p_world, T_world_robot)
    detectable = [
        min(corners.faces[i]) >= FACE_M and any(face_seen(outline, laser, T_world_robot, i, side) for side in (0, 1))
        for i in np.flatnonzero(seen).tolist()
    ]
    return Truth(
        to_robot(T_world_robot, corners.p_world[seen]),
        corners.convex[seen],
        corners.normals[seen] - T_world_robot[2],
        np.array(detectable, np.bool_),
        to_robot(T_world_robot, outline.doors.centre),
        doors_well_seen(outline, laser, T_world_robot),
    )


def face_seen(outline: Outline, laser: Laser, T_world_robot: Array, corner: int, side: int) -> bool:
    """True when 0.3 m and 5 beams of the face before (0) or after (1) the corner are visible, from the corner on."""
    p, length = outline.corners.p_world[corner], outline.corners.faces[corner, side]
    angle = outline.corners.normals[corner, side]
    normal = np.array([math.cos(angle), math.sin(angle)])
    along = np.array([-normal[1], normal[0]]) * (1.0 if side == 0 else -1.0)  # free space is on the left of a face
    if (T_world_robot[:2] - p) @ normal <= 0.0:
        return False
    samples = np.arange(0.5 * SAMPLE_M, min(length, FARTHEST_SAMPLE_M), SAMPLE_M)
    visible = laser.visible(p + samples[:, None] * along + 1e-4 * normal, T_world_robot)
    run = samples[np.logical_and.accumulate(visible)]
    if len(run) == 0 or run[-1] < SEEN_M - SAMPLE_M:
        return False
    _, bearings = polar(np.array([p, p + run[-1] * along]) - T_world_robot[:2]).T
    return bool(np.abs(wrapped(np.diff(bearings)))[0] >= SEEN_BEAMS * 2.0 * math.pi / laser.config.beams)


def doors_well_seen(outline: Outline, laser: Laser, T_world_robot: Array) -> Bools:
    """Doors (d,) with both jambs of the robot's side visible, within 3 m and 30 degrees."""
    doors = outline.doors
    normal = np.column_stack([np.cos(doors.normal), np.sin(doors.normal)])
    normal *= np.sign(((T_world_robot[:2] - doors.centre) * normal).sum(axis=1))[:, None]  # towards the robot
    face = doors.centre + normal * (0.5 * doors.thickness[:, None] + 1e-4)
    half = 0.4999 * doors.width[:, None] * np.column_stack([-normal[:, 1], normal[:, 0]])
    seen = laser.visible(face + half, T_world_robot) & laser.visible(face - half, T_world_robot)
    away = T_world_robot[:2] - face
    distance = np.hypot(*away.T)
    steep = (normal * away).sum(axis=1) >= math.cos(math.radians(30.0)) * distance
    return np.asarray(seen & steep & (distance <= 3.0), dtype=np.bool_)


def front_end(scan: Scan, config: SlamConfig) -> tuple[Corners, Array]:
    """The corners of a scan and the time (4,) of each stage, s."""
    rule, lines, laser = config.clustering.record, config.segments.record, config.sensor.record
    clock = [time.thread_time()]
    beams = merge_sweeps(scan.ranges, scan.bearings, scan.hit, scan.max_range_m, rule, laser)
    clock.append(time.thread_time())
    runs = cluster_beams(beams, rule, lines, laser, config.clustering.united(len(scan.ranges)))
    clock.append(time.thread_time())
    pieces = extract_segments(beams, runs, lines, laser)
    clock.append(time.thread_time())
    found = extract_corners(beams, pieces, config.corners.record, config.corners.gaps.record, laser)
    clock.append(time.thread_time())
    return Corners(*found[:7], Doorways(*found[7:])), np.diff(clock)


def score_places(places: Sequence[Place], preset: Preset, config: SlamConfig, assumed: str = "") -> list[Score]:
    """The scores of the scans of one preset, taken with the sensor model that fits it, or the `assumed` preset."""
    laser = with_noise_of(assumed or preset[0], preset[1])
    sensor = SensorModel(range_sigma_m=laser.range_sigma_m, bearing_sigma_deg=laser.bearing_sigma_deg)
    config = config.model_copy(update={"sensor": sensor})
    front_end(places[0].scans[preset], config)  # load compiled functions before timing
    return [score(place.truth, *front_end(place.scans[preset], config)) for place in places]


def score(truth: Truth, corners: Corners, seconds: Array) -> Score:
    """Compare the corners of a scan with ground truth."""
    partner = pair(truth, corners)
    rows = np.full((len(corners), 6), np.nan)
    rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 5] = corners.kind, corners.convex, corners.z[:, 0], partner >= 0
    right = np.flatnonzero(partner >= 0)
    p_robot = truth.p_robot[partner[right]]
    nu = corners.z[right] - polar(p_robot)
    nu[:, 1] = wrapped(nu[:, 1])
    rows[right, 3] = np.hypot(*(polar_to_points(corners.z[right]) - p_robot).T)
    rows[right, 4] = (nu * np.linalg.solve(corners.R[right], nu[:, :, None])[:, :, 0]).sum(axis=1)
    hit, easy = np.isin(np.arange(len(truth.convex)), partner), truth.detectable
    visible, found = (int(easy.sum()), int((~easy).sum())), (int(hit[easy].sum()), int(hit[~easy].sum()))
    return Score(rows.tolist(), visible, found, score_doors(truth, corners), seconds.tolist())


def pair(truth: Truth, corners: Corners) -> Ints:
    """(n,) the true corner of each corner, nearest pairs first, or -1."""
    distance = np.hypot(*np.moveaxis(polar_to_points(corners.z)[:, None] - truth.p_robot, 2, 0))
    turn = np.abs(wrapped(corners.normals[:, None] - truth.normals[None]))
    alike = (np.isnan(turn) | (turn < SIGNATURE_RAD)).all(axis=2) & (corners.convex[:, None] == truth.convex[None])
    return one_to_one(np.where(alike, distance, np.inf), NEAR_M)


def score_doors(truth: Truth, corners: Corners) -> tuple[int, int, int]:
    """Visible doors, how many of them were found, and false doors."""
    middles = polar_to_points(corners.z)[corners.doorways.jambs].mean(axis=1)
    near = np.hypot(*np.moveaxis(middles[:, None] - truth.doors, 2, 0)) < DOOR_M
    found = near.any(axis=0) & truth.well_seen
    return int(truth.well_seen.sum()), int(found.sum()), int((~near.any(axis=1)).sum())
