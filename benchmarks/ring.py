"""A ring of eight rooms driven along their centres, with known correspondences, for consistency tests.

Rooms of 6 x 6 m form a 3 x 3 grid without its centre; the robot sees the four corners of the room that it is in. The
true path is the same in all runs (unless the robot slips); noise affects the measurements only.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.drives import nees
from benchmarks.known_pairs import Sighting, cycle, polar
from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.se2 import to_robot, wrapped
from mecp_env.core.sensors import Odometry
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import make_filter

ROOM_M = 6.0
RING = ROOM_M * np.array([(0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1)])  # centres of the rooms
CORNERS = (RING[:, None] + np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (0.5 * ROOM_M - 0.1)).reshape(-1, 2)
TURN_M = 0.5 / (math.pi / 2)  # a turn of one radian counts as this many metres
SENSOR_SIGMA = np.array([0.05, math.radians(0.3)])  # the paper's, range and bearing
ODOMETRY_SIGMA = np.array([0.1, math.radians(1.5)])  # the paper's, distance and heading

Variance = Callable[[Array], Array]


def length(arcs: Array) -> Array:
    """(M,1) m of each arc, turns included."""
    return np.abs(arcs[:, :1]) + TURN_M * np.abs(arcs[:, 1:])


def per_metre(arcs: Array) -> Array:
    """(M,2) variances of distance and turn: sigma sqrt(m)."""
    return ODOMETRY_SIGMA**2 * length(arcs)


def per_step(arcs: Array) -> Array:
    """(M,2): the paper's sigmas in every step, whatever its length."""
    return np.tile(ODOMETRY_SIGMA**2, (len(arcs), 1))


def linear(arcs: Array) -> Array:
    """(M,2): a tenth of the distance, 1.5 degrees per metre."""
    return (ODOMETRY_SIGMA * length(arcs)) ** 2


@dataclass(frozen=True, eq=False)
class Course:
    """Ground truth of a drive, step by step."""

    arcs: Array  # (S,2) m, rad: distance and turn measured by odometry
    slipped: Bools  # (S,) bumper flag
    T_true: Array  # (S,3)
    ids: list[Ints]  # (S) of (n,) visible corners
    z: list[Array]  # (S) of (n,2) noise-free
    lap: Array  # (S,) laps driven at the end of the step

    @property
    def closure(self) -> int:
        """The step in which the first room is seen again after a lap, or -1."""
        return next((k for k, ids in enumerate(self.ids) if self.lap[k] > 0.5 and 0 in ids), -1)


def straight_and_turn(step_m: float, laps: float) -> Array:
    """(S,2) distance and turn of each step: straight between room centres, turning in place at corners."""
    arcs: list[tuple[float, float]] = []
    steps = round(ROOM_M / step_m)
    for leg in range(math.ceil(laps * len(RING))):
        arcs += [(ROOM_M / steps, 0.0)] * steps + [(0.0, math.pi / 12)] * 6 * (leg % 2)
    return np.array(arcs)


def make_course(step_m: float = 0.25, laps: float = 2.0, slips: Array | None = None) -> Course:
    """Laps round the ring; slips (S,2) m, rad: sideways and heading slip after each step, unseen by odometry."""
    arcs = straight_and_turn(step_m, laps)
    slips = np.zeros_like(arcs) if slips is None else slips
    T, path = np.zeros(3), []
    for (d, w), (sideways, turn) in zip(arcs, slips, strict=True):
        for along, aside, angle in ((d, 0.0, w), (0.0, sideways, turn)):
            c, s = np.cos(T[2] + angle / 2), np.sin(T[2] + angle / 2)
            T = T + np.array([along * c - aside * s, along * s + aside * c, angle])
        path.append(T)
    T_true = np.array(path)
    room = np.linalg.norm(RING[None] - T_true[:, None, :2], axis=2).argmin(axis=1)
    ids = [4 * number + np.arange(4) for number in room]
    z = [polar(to_robot(T, CORNERS[seen])) for T, seen in zip(T_true, ids, strict=True)]
    lap = np.arange(1, len(arcs) + 1) / len(straight_and_turn(step_m, 1))
    return Course(arcs, np.any(slips != 0.0, axis=1), T_true, ids, z, lap)


def drive(
    rng: np.random.Generator, course: Course, variance: Variance = per_metre
) -> Iterator[tuple[Odometry, Sighting]]:
    """The measurements of one robot in each step of the course."""
    for arc, slipped, ids, z in zip(course.arcs, course.slipped, course.ids, course.z, strict=True):
        var = variance(arc[None])
        odometry = Odometry(arc + rng.normal(size=(1, 2)) * np.sqrt(var), var[:, :, None] * np.eye(2), bool(slipped))
        R = np.diag(np.tile(SENSOR_SIGMA**2, len(ids)))
        yield odometry, Sighting(z + rng.normal(size=z.shape) * SENSOR_SIGMA, R, ids)


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


def one_run(config: FilterConfig, seed: int, course: Course, variance: Variance, iterate: bool) -> tuple[Array, Array]:
    """NEES and position error after every step; the update that closes the loop may be iterated."""
    estimate, closure, beliefs = make_filter(config), course.closure, []
    for k, (odometry, sighting) in enumerate(drive(np.random.default_rng(seed), course, variance)):
        estimate.predict(odometry)
        cycle(estimate, sighting, lambda seen, last=iterate and k == closure: estimate.update(*seen, last))
        beliefs.append(estimate.belief())
    e = course.T_true - np.array([belief.T_map_robot for belief in beliefs])
    e[:, 2] = wrapped(e[:, 2])
    return nees(e, np.array([belief.pose_cov for belief in beliefs])), np.hypot(*e[:, :2].T)


def monte_carlo(
    config: FilterConfig,
    course: Course | list[Course],
    runs: int,
    *,
    variance: Variance = per_metre,
    iterate: bool = True,
) -> Runs:
    """`runs` runs with seeds 0, 1, ... over one course, or over one each."""
    courses = course if isinstance(course, list) else [course] * runs
    rows = [one_run(config, seed, courses[seed], variance, iterate) for seed in range(runs)]
    return Runs(*map(np.array, zip(*rows, strict=True)), courses[0].lap, courses[0].closure)
