"""A ring of eight rooms driven along their centres, with known correspondences, for consistency tests.

Rooms of 6 x 6 m form a 3 x 3 grid without its centre; the robot sees the four corners of the room that it is in. The
true path is the same in all runs (unless the robot slips); noise affects the measurements only.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.errors import nees
from benchmarks.known_pairs import Sighting
from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.se2 import wrapped
from mecp_env.core.sensors import Odometry
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import Filter, make_filter

ROOM_M = 6.0
RING = [(0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1)]
TURN_M = 0.5 / (math.pi / 2)  # a turn of one radian counts as this many metres
SENSOR_SIGMA = np.array([0.05, math.radians(0.3)])  # the paper's, range and bearing
DISTANCE_SIGMA, HEADING_SIGMA = 0.1, math.radians(1.5)  # the paper's

Variance = Callable[[Array], Array]


def per_metre(arcs: Array) -> Array:
    """(M,2) variances of distance and turn: sigma sqrt(m)."""
    length = np.abs(arcs[:, 0]) + TURN_M * np.abs(arcs[:, 1])
    return np.stack([DISTANCE_SIGMA**2 * length, HEADING_SIGMA**2 * length], axis=1)


def per_step(arcs: Array) -> Array:
    """(M,2): the paper's sigmas in every step, whatever its length."""
    return np.tile([DISTANCE_SIGMA**2, HEADING_SIGMA**2], (len(arcs), 1))


def linear(arcs: Array) -> Array:
    """(M,2): a tenth of the distance, 1.5 degrees per metre."""
    length = np.abs(arcs[:, 0]) + TURN_M * np.abs(arcs[:, 1])
    return np.stack([(0.1 * length) ** 2, (HEADING_SIGMA * length) ** 2], axis=1)


def corners() -> tuple[Array, Ints]:
    """(32,2) true corners in the world, and the (32,) room of each."""
    inset = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (0.5 * ROOM_M - 0.1)
    return np.concatenate([ROOM_M * np.array(c) + inset for c in RING]), np.repeat(np.arange(len(RING)), 4)


def nearest_room(p: Array) -> int:
    """Index in RING of the room at p (2,)."""
    return int(np.argmin(np.linalg.norm(ROOM_M * np.array(RING) - p, axis=1)))


def moved(T: Array, d: float, sideways: float, w: float) -> Array:
    """The pose after an arc of length d and turn w, with a slip to the left."""
    c, s = np.cos(T[2] + w / 2), np.sin(T[2] + w / 2)
    return T + np.array([d * c - sideways * s, d * s + sideways * c, w])


def measure(T: Array, points: Array) -> Array:
    """(n,2) noise-free range and bearing."""
    d = points - T[:2]
    return np.stack([np.hypot(d[:, 0], d[:, 1]), wrapped(np.arctan2(d[:, 1], d[:, 0]) - T[2])], axis=1)


@dataclass(frozen=True, eq=False)
class Course:
    """Ground truth of a drive, step by step."""

    arcs: Array  # (S,2) m, rad: distance and turn measured by odometry
    slipped: Bools  # (S,) bumper flag
    T_true: list[Array]  # (S) of (3,)
    ids: list[Ints]  # (S) of (n,) visible corners
    z: list[Array]  # (S) of (n,2) noise-free
    lap: Array  # (S,) laps driven at the end of the step


def straight_and_turn(step_m: float, laps: float) -> Array:
    """(S,2) distance and turn of each step: straight between room centres, turning in place at corners."""
    arcs: list[tuple[float, float]] = []
    steps = round(ROOM_M / step_m)
    for leg in range(math.ceil(laps * len(RING))):
        arcs += [(ROOM_M / steps, 0.0)] * steps
        if leg % 2 == 1:
            arcs += [(0.0, math.pi / 12)] * 6
    return np.array(arcs)


def make_course(step_m: float = 0.25, laps: float = 2.0, slips: Array | None = None) -> Course:
    """Laps round the ring; slips (S,2) m, rad: sideways and heading slip after each step, unseen by odometry."""
    landmarks, room = corners()
    arcs = straight_and_turn(step_m, laps)
    slips = np.zeros_like(arcs) if slips is None else slips
    lap = np.arange(1, len(arcs) + 1) / len(straight_and_turn(step_m, 1))
    course = Course(arcs, np.any(slips != 0.0, axis=1), [], [], [], lap)
    T = np.zeros(3)
    for (d, w), (sideways, turn) in zip(arcs, slips, strict=True):
        T = moved(moved(T, d, 0.0, w), 0.0, sideways, turn)
        seen = np.flatnonzero(room == nearest_room(T[:2]))
        course.T_true.append(T)
        course.ids.append(seen)
        course.z.append(measure(T, landmarks[seen]))
    return course


def drive(
    rng: np.random.Generator, course: Course, variance: Variance = per_metre, arcs_per_step: int = 1
) -> Iterator[tuple[Odometry, Sighting]]:
    """The measurements of one robot in each step of the course."""
    for arc, slipped, ids, z in zip(course.arcs, course.slipped, course.ids, course.z, strict=True):
        parts = np.tile(arc / arcs_per_step, (arcs_per_step, 1))
        var = variance(parts)
        measured = parts + rng.normal(size=parts.shape) * np.sqrt(var)
        odometry = Odometry(measured, var[:, :, None] * np.eye(2), bool(slipped))
        R = np.diag(np.tile(SENSOR_SIGMA**2, len(ids)))
        yield odometry, Sighting(z + rng.normal(size=z.shape) * SENSOR_SIGMA, R, ids)


def cycle(estimate: Filter, odometry: Odometry, sighting: Sighting, iterate: bool = False) -> None:
    """Predict, update with known landmarks, augment new ones."""
    estimate.predict(odometry)
    known = np.isin(sighting.ids, estimate.ids)
    seen, new = sighting.part(known), sighting.part(~known)
    estimate.update(seen.z, seen.R, seen.ids, iterate)
    estimate.augment(new.z, new.R, new.ids)


@dataclass(frozen=True, eq=False)
class Runs:
    """The results of a set of runs."""

    nees: Array  # (runs, S)
    error_m: Array  # (runs, S)
    lap: Array  # (S,)
    closure: int  # the step that closes the loop

    def mean_nees(self, first_lap: float, last_lap: float) -> float:
        """Mean NEES between two lap counts."""
        return float(self.nees[:, (self.lap > first_lap) & (self.lap <= last_lap)].mean())


def config_of(kind: str) -> FilterConfig:
    """A filter whose start is uncertain by 1 mm: here nothing allows for what one linearisation neglects."""
    return FilterConfig(kind=kind, prior_sigma_m=0.001, prior_sigma_rad=1e-4)


def one_run(
    config: FilterConfig, seed: int, course: Course, closure: int, variance: Variance, arcs_per_step: int
) -> tuple[Array, Array]:
    """NEES and position error after every step; the update of step `closure` is iterated."""
    estimate, errors, covs = make_filter(config), [], []
    for k, (odometry, sighting) in enumerate(drive(np.random.default_rng(seed), course, variance, arcs_per_step)):
        cycle(estimate, odometry, sighting, iterate=k == closure)
        belief = estimate.belief()
        errors.append(course.T_true[k] - belief.T_map_robot)
        covs.append(belief.pose_cov)
    e = np.array(errors)
    e[:, 2] = wrapped(e[:, 2])
    return nees(e, np.array(covs)), np.hypot(*e[:, :2].T)


def monte_carlo(
    config: FilterConfig,
    course: Course | list[Course],
    runs: int,
    *,
    variance: Variance = per_metre,
    arcs_per_step: int = 1,
    iterate: bool = True,
) -> Runs:
    """`runs` runs with seeds 0, 1, ... over one course, or over one each."""
    courses = course if isinstance(course, list) else [course] * runs
    closing = closing_step(courses[0])
    iterated = closing if iterate else -1
    rows = [one_run(config, seed, courses[seed], iterated, variance, arcs_per_step) for seed in range(runs)]
    return Runs(*map(np.array, zip(*rows, strict=True)), courses[0].lap, closing)


def closing_step(course: Course) -> int:
    """The step in which the first room is seen again after a lap, or -1."""
    for k, ids in enumerate(course.ids):
        if course.lap[k] > 0.5 and 0 in ids:
            return k
    return -1
