"""Whether a custom filter or associator does what the estimator asks of it, on constructed data.

A check raises the error of the part (`FilterError`, `MatchError`) with the method that is wrong, and `ConfigError` for
methods that are missing. It says nothing of how good a part is; for that, the benchmarks `association` and `filters`
compare it on recorded drives.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator
from dataclasses import fields
from typing import Any

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.se2 import compose, to_robot
from mecp_env.core.sensors import Odometry, Scan
from mecp_env.slam.checks import MatchError, check_match
from mecp_env.slam.config import AssociationConfig, FilterConfig, SlamConfig
from mecp_env.slam.custom import check_belief, check_custom_match, check_part
from mecp_env.slam.messages import Belief, Corners, MapView, Match, Polygon
from mecp_env.slam.pipeline import SlamPipeline
from mecp_env.slam.protocols import Associator, Filter, FilterError
from mecp_env.world.config import LaserConfig
from mecp_env.world.laser import Laser
from mecp_env.world.layout import load_layout
from mecp_env.world.outline import build_outline

POINTS = np.array([[2.0, 1.0], [3.0, -1.5], [4.0, 2.0], [1.0, -2.0], [5.0, 0.5], [2.5, 3.0]])  # m, map frame
SIGMA_M, SIGMA_RAD = 0.02, 0.005
STEP_M, TURN_RAD, STEPS = 0.1, 0.05, 8
ARC = np.array([STEP_M * math.cos(TURN_RAD / 2), STEP_M * math.sin(TURN_RAD / 2), TURN_RAD])


def check_filter(make: Callable[[FilterConfig], Filter]) -> None:
    """Raise `FilterError` unless the filter that `make` makes keeps to the protocol `Filter` (slam/protocols.py).

    Six landmarks are taken in and seen again on a short drive. Shapes, finite numbers and positive covariances of all
    results are asked for, the same numbers by `belief`, `marginal`, `innovation` and `individual_nis`, a copy that is
    independent, an update that makes the pose surer, and a `FilterError` for an id that does not exist, with the state
    as it was.
    """
    estimate, rng = make(FilterConfig()), np.random.default_rng(0)
    check_part(estimate, "filter", Filter)
    ids = np.arange(10, 10 + len(POINTS))
    estimate.augment(*seen(np.zeros(3), rng), ids)
    _require(np.array_equal(estimate.ids, ids), "augment: the ids are not in the order of their initialisation")
    T, motion = np.zeros(3), Odometry(np.array([[STEP_M, TURN_RAD]]), np.diag([0.01, 0.01])[None] ** 2, bumper=False)
    for _ in range(STEPS):
        estimate.predict(motion)
        T = compose(T, ARC)
        before = _sound(estimate, ids, "predict")
        z, R = seen(T, rng)
        _check_pairs(estimate, z, R, ids)
        estimate.update(z, R, ids)
        after = _sound(estimate, ids, "update")
        surer = np.trace(after.pose_cov) < np.trace(before.pose_cov)
        _require(bool(surer), "update: the pose is no surer after six landmarks were recognised")
    off = estimate.belief().T_map_robot - T
    _require(float(np.abs(off).max()) < 0.1, f"update: the pose is off by {np.round(off, 3).tolist()} m, m, rad")
    _check_copy(estimate, z, R, ids)
    _check_removal(estimate, ids)


def seen(T_map_robot: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """z (6,2) and R (12,12): all points from a pose, with noise."""
    x, y = to_robot(T_map_robot, POINTS).T
    z = np.column_stack((np.hypot(x, y), np.arctan2(y, x)))
    sigmas = np.tile([SIGMA_M, SIGMA_RAD], len(POINTS))
    return z + (sigmas * rng.standard_normal(len(sigmas))).reshape(z.shape), np.diag(sigmas**2)


def _check_pairs(estimate: Filter, z: Array, R: Array, ids: Ints) -> None:
    """Innovation and NIS of pairs must say the same."""
    first = slice(0, 2)
    nu, S = estimate.innovation(z[:1], R[first, first], ids[:1])
    _require(nu.shape == (2,) and S.shape == (2, 2), f"innovation: shapes {nu.shape}, {S.shape}, (2,), (2, 2) expected")
    _require(bool(np.linalg.eigvalsh(S).min() > 0.0), "innovation: S is not positive")
    blocks = np.array([R[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] for i in range(len(z))])
    fewer = estimate.individual_nis(z[1:], blocks[1:], ids)
    expected = len(z) - 1, len(ids)
    _require(np.shape(fewer) == expected, f"individual_nis: shape {np.shape(fewer)}, {expected} expected")
    nis = estimate.individual_nis(z, blocks, ids)
    same = math.isclose(float(nu @ np.linalg.solve(S, nu)), float(nis[0, 0]), rel_tol=0.05, abs_tol=0.01)
    _require(same, "individual_nis: another NIS than by `innovation`")
    own = nis.argmin(axis=1)
    _require(np.array_equal(own, np.arange(len(z))), "individual_nis: a landmark is nearer to another's measurement")
    joint = estimate.joint_nis(z, R, ids)
    _require(math.isfinite(joint) and joint >= 0.0, f"joint_nis: {joint:g}, a number of at least 0 expected")


def _check_copy(estimate: Filter, z: Array, R: Array, ids: Ints) -> None:
    mean, cov = estimate.marginal(ids[:2])
    shapes = mean.shape, cov.shape
    _require(shapes == ((7,), (7, 7)), f"marginal: shapes {shapes}, (7,), (7, 7) expected")
    kept, other = estimate.belief(), estimate.copy()
    _require(type(other) is type(estimate), f"copy: a {type(other).__name__}, another class")
    _require(bool(np.allclose(mean[:3], kept.T_map_robot)), "marginal: another pose than that of `belief`")
    other.update(z, R, ids)
    other.loosen(np.diag([1.0, 1.0, 0.1]))
    other.set_pose(np.array([5.0, 5.0, 1.0]), 0.01 * np.eye(3))
    _require(_same(kept, estimate.belief()), "copy: what is done to a copy changes the filter")
    _require(bool(np.allclose(other.belief().T_map_robot, [5.0, 5.0, 1.0])), "set_pose: the pose is another one")
    try:
        estimate.update(z[:1], R[:2, :2], np.array([999]))
    except FilterError:
        _require(_same(kept, estimate.belief()), "update: an id that does not exist changes the state")
    else:
        raise FilterError("update: an id that does not exist, 999, is taken")


def _check_removal(estimate: Filter, ids: Ints) -> None:
    estimate.remove(ids[2:3])
    left = np.delete(ids, 2)
    _require(np.array_equal(estimate.ids, left), "remove: other ids are left than those that were not named")
    _require(not estimate.has(int(ids[2])) and estimate.has(int(ids[3])), "has: the ids are others than those of `ids`")
    _sound(estimate, left, "remove")


def _sound(estimate: Filter, ids: Ints, method: str) -> Belief:
    belief = check_belief(estimate.belief(), ids, method)
    _require(np.array_equal(belief.ids, estimate.ids), "belief: the ids are in another order than those of `ids`")
    return belief


def _same(one: Belief, other: Belief) -> bool:
    pairs = ((one.T_map_robot, other.T_map_robot), (one.pose_cov, other.pose_cov), (one.p_map, other.p_map))
    return all(np.array_equal(a, b) for a, b in pairs)


def _require(holds: bool, said: str) -> None:
    if not holds:
        raise FilterError(said)


class Watched(Associator):
    """An associator that is looked at: its matches are checked, and that map and filter stay as they are."""

    def __init__(self, associator: Associator) -> None:
        self.associator, self.certain, self.recognised = associator, associator.certain, 0  # type: ignore[misc]

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """That of the associator. Raises `MatchError`."""
        before, given = belief.belief(), (corners, *polygons, view.belief, view.features)
        bits = _bits_of(given)
        match = self.associator.associate(corners, polygons, view, belief)
        check_match(match, len(corners), len(view.features))
        check_custom_match(match, view.features, len(polygons), sum(len(g.index) for g in view.groups.values()))
        if not _same(before, belief.belief()):
            raise MatchError("associate: it changes the filter or the map")
        if bits != _bits_of(given):
            raise MatchError("associate: it changes the corners, the polygons or the map that it is given")
        again = copy.deepcopy(self.associator).associate(corners, polygons, view, belief.copy())
        if not np.array_equal(match.ids, again.ids):
            raise MatchError("associate: another match for the same scan, map and filter")
        self.recognised += match.found
        return match

    def remember(self, match: Match) -> None:
        """Pass it on."""
        self.associator.remember(match)


def _bits_of(given: tuple[Any, ...]) -> list[bytes]:
    """The content of all arrays in the fields of messages."""
    values = [getattr(message, field.name) for message in given for field in fields(message)]
    return [value.tobytes() for value in values if isinstance(value, np.ndarray)]


def check_associator(make: Callable[[AssociationConfig], Associator]) -> int:
    """How many corners the associator that `make` makes recognises on a short drive in one room.

    Raises `MatchError` where a match has columns of another length or type, an id that was never given out, a landmark
    twice, where filter, map or anything else that is given is changed, and where the same question is answered
    differently.
    """
    config = SlamConfig()
    made = make(config.association)
    check_part(made, "associator", Associator)
    watched = Watched(made)
    pipeline, scans = SlamPipeline(config, associator=watched), room_scans()
    motion = Odometry(np.array([[STEP_M, 0.0]]), np.diag([0.003, 0.003])[None] ** 2, bumper=False)
    output = pipeline.start(next(scans))
    for scan in scans:
        output = pipeline.step(motion, scan)
    if not len(output.belief.ids):
        raise MatchError("associate: after a drive in one room, there is no landmark: no corner was left to be new")
    return watched.recognised


def room_scans() -> Iterator[Scan]:
    """Scans without noise on a straight drive in the west room of the layout `two_rooms`."""
    outline, rng = build_outline(load_layout("two_rooms")), np.random.default_rng(0)
    laser = Laser(outline, LaserConfig(preset="ideal", sweeps=1))
    for step in range(2 * STEPS + 1):
        yield laser.scan(compose(np.array(outline.starts[0]), np.array([step * STEP_M, 0.0, 0.0])), rng)
