"""A ring of eight rooms driven along their centres, with known identities: the ground for consistency tests.

Rooms of 6 x 6 m stand on a 3 x 3 grid without its middle; the robot sees the four corners of the room it is in. The
true path is the same in all runs, noise is on what is measured.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mecp_env.slam.config import FilterConfig
from mecp_env.slam.data import Belief, Odometry
from mecp_env.slam.filters import Filter, make_filter

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

ROOM_M = 6.0
RING = [(0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1)]
TURN_M = 0.5 / (np.pi / 2)  # noise of a turn, in metres of driving a radian
RANGE_SIGMA, BEARING_SIGMA = 0.05, np.radians(0.3)
DISTANCE_SIGMA, HEADING_SIGMA = 0.1, np.radians(1.5)


@dataclass(frozen=True, eq=False)
class Step:
    """What is true and what is measured in one period."""

    T_true: Array  # (3,) x, y, heading
    odometry: Odometry
    z: Array  # (n,2)
    R: Array  # (2n,2n)
    ids: Ints  # (n,)
    lap: float  # laps driven


def per_metre(arcs: Array) -> Array:
    """(M,2) variances of distance and turn: sigma sqrt(m)."""
    length = np.abs(arcs[:, 0]) + TURN_M * np.abs(arcs[:, 1])
    return np.stack([DISTANCE_SIGMA**2 * length, HEADING_SIGMA**2 * length], axis=1)


def per_step(arcs: Array) -> Array:
    """(M,2): the paper's sigmas in every step, however short."""
    return np.tile([DISTANCE_SIGMA**2, HEADING_SIGMA**2], (len(arcs), 1))


def corners() -> tuple[Array, Ints]:
    """(32,2) true corners in the world, and the (32,) room of each."""
    inset = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (0.5 * ROOM_M - 0.1)
    return np.concatenate([ROOM_M * np.array(c) + inset for c in RING]), np.repeat(np.arange(len(RING)), 4)


def true_arcs(step_m: float, laps: int) -> Array:
    """(S,2) distance and turn of each step: straight between the centres of rooms, turning on the spot at corners."""
    arcs: list[tuple[float, float]] = []
    steps = round(ROOM_M / step_m)
    for leg in range(laps * len(RING)):
        arcs += [(ROOM_M / steps, 0.0)] * steps
        if leg % 2 == 1:
            arcs += [(0.0, np.pi / 12)] * 6
    return np.array(arcs)


def drive(
    rng: np.random.Generator,
    variance: Callable[[Array], Array] = per_metre,
    step_m: float = 0.25,
    laps: int = 2,
    arcs_per_step: int = 1,
    slip: Callable[[int], tuple[float, float]] | None = None,
) -> Iterator[Step]:
    """The steps of one run. slip(k): sideways and heading slip in step k that odometry does not see (bumper set)."""
    landmarks, room = corners()
    T = np.zeros(3)
    for k, (d, w) in enumerate(arcs := true_arcs(step_m, laps)):
        lateral, turn = slip(k) if slip else (0.0, 0.0)
        T = moved(moved(T, d, 0.0, w), 0.0, lateral, turn)
        parts = np.tile([d, w], (arcs_per_step, 1)) / arcs_per_step
        var = variance(parts)
        measured = parts + rng.normal(size=parts.shape) * np.sqrt(var)
        odometry = Odometry(measured, var[:, :, None] * np.eye(2), bool(lateral or turn))
        seen = np.flatnonzero(room == nearest_room(T[:2]))
        z = measure(T, landmarks[seen])
        z = z + rng.normal(size=z.shape) * [RANGE_SIGMA, BEARING_SIGMA]
        R = np.diag(np.tile([RANGE_SIGMA**2, BEARING_SIGMA**2], len(seen)))
        yield Step(T, odometry, z, R, seen, laps * (k + 1) / len(arcs))


def moved(T: Array, d: float, sideways: float, w: float) -> Array:
    """The pose after an arc of length d and turn w, with a slip to the left."""
    c, s = np.cos(T[2] + w / 2), np.sin(T[2] + w / 2)
    return T + np.array([d * c - sideways * s, d * s + sideways * c, w])


def nearest_room(p: Array) -> int:
    """Index in RING of the room at p (2,)."""
    return int(np.argmin(np.linalg.norm(ROOM_M * np.array(RING) - p, axis=1)))


def measure(T: Array, points: Array) -> Array:
    """(n,2) noise-free range and bearing."""
    d = points - T[:2]
    return np.stack([np.hypot(d[:, 0], d[:, 1]), wrap(np.arctan2(d[:, 1], d[:, 0]) - T[2])], axis=1)


def wrap(angle: Array) -> Array:
    """In [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def nees(belief: Belief, T_true: Array) -> float:
    """Normalised estimation error squared of the pose; 3 expected."""
    e = T_true - belief.T_map_robot
    e[2] = wrap(e[2])
    return float(e @ np.linalg.solve(belief.pose_cov, e))


def cycle(estimate: Filter, step: Step, iterate: bool = False) -> None:
    """Predict, update by known landmarks, take in new ones."""
    estimate.predict(step.odometry)
    known = np.array([estimate.has(int(i)) for i in step.ids])
    rows = np.repeat(known, 2)
    estimate.update(step.z[known], step.R[np.ix_(rows, rows)], step.ids[known], iterate)
    estimate.augment(step.z[~known], step.R[np.ix_(~rows, ~rows)], step.ids[~known])


@dataclass(frozen=True, eq=False)
class Figures:
    """What a set of runs gave."""

    nees: Array  # (runs, steps)
    error_m: Array  # (runs, steps)
    lap: Array  # (steps,)
    closure: int  # the step that comes home

    def mean(self, first: float, last: float) -> float:
        """Mean NEES between two lap counts."""
        return float(self.nees[:, (self.lap > first) & (self.lap <= last)].mean())


def monte_carlo(
    kind: str, runs: int, iterate_closure: bool = True, config: dict[str, float] | None = None, **options: object
) -> Figures:
    """Figures of `runs` runs with seeds 0, 1, ...; the first look at home again after lap 1 is the closure."""
    rows, errors, laps, closure = [], [], [], -1
    for seed in range(runs):
        estimate = make_filter(FilterConfig(kind=kind, **(config or {})))
        row, error, laps, last_home = [], [], [], 0
        for k, step in enumerate(drive(np.random.default_rng(seed), **options)):
            closes = bool(estimate.has(0)) and 0 in step.ids and k - last_home > 50
            closure = k if closes and closure < 0 else closure
            last_home = k if 0 in step.ids else last_home
            cycle(estimate, step, iterate=closes and iterate_closure)
            belief = estimate.belief()
            row.append(nees(belief, step.T_true))
            error.append(np.hypot(*(belief.T_map_robot - step.T_true)[:2]))
            laps.append(step.lap)
        rows.append(row)
        errors.append(error)
    return Figures(np.array(rows), np.array(errors), np.array(laps), closure)
