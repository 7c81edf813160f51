"""Custom associators, filters and structures: how they become known, and what they must keep to in a run.

The parts of this package are not asked. `mecp_env.evaluation.part_checks` tries a part on constructed data before.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from typing import Any, Self, TypeVar

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.errors import ConfigError
from mecp_env.core.settings import Names, load_parts, shown
from mecp_env.core.snapshot import PACKAGE, admit
from mecp_env.core.snapshot_check import FAR
from mecp_env.slam.checks import ROUNDING, MatchError, require_arrays
from mecp_env.slam.messages import Belief, Decision, EdgeLabel, FeatureState, FeatureTable, Match, Polygon, Reason
from mecp_env.slam.protocols import AnswerError, Filter, FilterError

FLOATS, IDS = np.dtype(np.float64), np.dtype(np.int64)
REASONS = np.array(list(map(int, Reason)))
COPIED = ("divergence", "guard", "recent")  # what changes in place before the grid is painted
DEEPLY = ("map", "rooms")  # the same, inside


Make = TypeVar("Make", bound=Callable[..., object])


def register(names: Names, makers: MutableMapping[str, Make], name: str, make: Make) -> None:
    """Make `name` known, and states ready to hold what `make` makes, where that is a class. Raises `ConfigError`."""
    if not callable(make):
        raise ConfigError(f"make: {shown(make)}, a class or a function expected")
    names.add(name)
    makers[name] = make
    if isinstance(make, type):
        admit(make)


def maker_of(makers: Mapping[str, Make], name: str) -> Make:
    """What makes the part with a name that a configuration may have. Raises `ConfigError` where nothing does."""
    if name not in makers:
        load_parts()
    if name not in makers:
        raise ConfigError(f"{name!r}: no installed package has this part; is mecp_env installed (pip install -e .)?")
    return makers[name]


def is_ours(part: object) -> bool:
    """True for a part that this package defines; a wrapper is what it has as `stands_for`."""
    return type(getattr(part, "stands_for", part)).__module__.partition(".")[0] == PACKAGE


def check_part(part: object, what: str, base: type) -> None:
    """Raise `ConfigError` unless `part` is an object with all that `base` declares."""
    where = f"{base.__module__}.{base.__name__}"
    if isinstance(part, type):
        raise ConfigError(f"{what}: the class {part.__name__}, an object of it expected")
    lacking = [name for name in vars(base) if not name.startswith("_") and not hasattr(part, name)]
    if lacking:
        raise ConfigError(f"{what}: {type(part).__name__} has no {', '.join(lacking)}; derive from {where}")


@contextmanager
def unchanged(part: object, **given: Any) -> Iterator[None]:
    """Within it a custom part is asked. Raises `MatchError` where it wrote to the arrays of what it was `given`."""
    arrays = [(f"{name}.{column}", array) for name, one in given.items() for column, array in arrays_of(one)]
    before = [array.copy() for _, array in arrays]
    yield
    for (name, array), kept in zip(arrays, before, strict=True):
        if array.tobytes() != kept.tobytes():
            array[...] = kept
            raise MatchError(f"{type(part).__name__}: it wrote to {name}, which it was given")


def arrays_of(carrier: object) -> Iterator[tuple[str, Any]]:
    """The arrays of a message that can be written to, by name."""
    for field in fields(carrier):  # type: ignore[arg-type]  # a dataclass
        array = getattr(carrier, field.name)
        if isinstance(array, np.ndarray) and array.flags.writeable:
            yield field.name, array


@dataclass(slots=True, eq=False)
class CheckedFilter:
    """A custom filter that is asked: `AnswerError` for a test whose answer no compiled function could take."""

    inner: Filter

    def individual_nis(self, z: Array, R: Array, ids: Ints) -> Array:
        (nis,) = self._arrays("individual_nis", (z, R, ids), (len(z), len(ids)))
        return nis

    def innovation(self, z: Array, R: Array, ids: Ints) -> tuple[Array, Array]:
        n = 2 * len(z)
        nu, S = self._arrays("innovation", (z, R, ids), (n,), (n, n))
        return nu, S

    def marginal(self, ids: Ints) -> tuple[Array, Array]:
        n = 3 + 2 * len(ids)
        mean, cov = self._arrays("marginal", (ids,), (n,), (n, n))
        return mean, cov

    def joint_nis(self, *given: Any, **options: Any) -> float:
        return self._number("joint_nis", *given, **options)

    def mean_of_gaussians_nis(self, *given: Any, **options: Any) -> float:
        return self._number("mean_of_gaussians_nis", *given, **options)

    def log_bayes_factor(self, *given: Any) -> float:
        return self._number("log_bayes_factor", *given)

    def copy(self) -> Self:
        """One that stands for a copy of the filter."""
        return replace(self, inner=self.inner.copy())

    def _arrays(self, name: str, given: tuple[Any, ...], *shapes: tuple[int, ...]) -> tuple[Array, ...]:
        answer = getattr(self.inner, name)(*given)
        parts: tuple[Array, ...] = answer if isinstance(answer, tuple) else (answer,)
        found = [f"{part.dtype} {part.shape}" if isinstance(part, np.ndarray) else shown(part) for part in parts]
        expected = [f"float64 {shape}" for shape in shapes]
        if found != expected:
            said = f"{', '.join(found)}; {', '.join(expected)} expected"
            raise AnswerError(f"{type(self.inner).__name__}.{name}: {said}")
        return parts

    def _number(self, name: str, *given: Any, **options: Any) -> float:
        answer = getattr(self.inner, name)(*given, **options)
        if not isinstance(answer, float | int | np.floating | np.integer):
            raise AnswerError(f"{type(self.inner).__name__}.{name}: {shown(answer)}, a number expected")
        return float(answer)

    def __getattr__(self, name: str) -> Any:
        if name in self.__slots__ or name.startswith("__"):  # absent while a copy is made
            raise AttributeError(name)
        return getattr(self.inner, name)


class BegunStep:
    """A context for all of a step that asks associator and filter: all but the painting of the grid."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        pass


class UndoneOnError(BegunStep):
    """One that leaves the estimator as it was where something fails in it."""

    def __init__(self, parts: Any) -> None:
        self.parts, self.kept = parts, {"step_count": parts.step_count, "filter": parts.filter}
        self.kept |= {name: copy.copy(getattr(parts, name)) for name in COPIED}
        self.kept["recent"].scans = list(parts.recent.scans)
        fixed = {id(thing): thing for thing in (parts.config, *parts.map.polygons.polygons)}  # which nothing changes
        self.kept |= {name: copy.deepcopy(getattr(parts, name), fixed.copy()) for name in DEEPLY}
        parts.filter = parts.filter.copy()

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        for name, value in self.kept.items() if kind is not None else ():
            setattr(self.parts, name, value)


def check_custom_match(match: Match, features: FeatureTable, polygons: int, map_polygons: int) -> None:
    """Raise `MatchError` unless a match that `check_match` accepts names landmarks, each once, and what there is.

    `polygons` and `map_polygons`: how many there are of the scan, and in the map.
    """
    corners = np.flatnonzero(match.decision == Decision.LANDMARK)
    ids = match.ids[corners]
    wrong = features.rows["state"][ids] != FeatureState.LANDMARK
    if wrong.any():
        first = int(wrong.argmax())
        raise MatchError(f"match.ids[{corners[first]}]: {ids[first]} is a track, or removed; a landmark expected")
    if len(set(ids.tolist())) < len(ids):
        raise MatchError(f"match.ids: {sorted(ids.tolist())}, each landmark at most once expected")
    if not np.isin(match.reason, REASONS).all():
        raise MatchError(f"match.reason: {sorted(set(match.reason.tolist()))}, members of Reason expected")
    for name, count in (("polygon", polygons), ("known", map_polygons)):
        index = getattr(match, name)
        if not isinstance(index, int | np.integer) or not -1 <= index < count:
            raise MatchError(f"match.{name}: {shown(index)}, a number from -1 to {count - 1} expected")


def check_polygons(name: str, found: Any, corners: int) -> None:
    """Raise `ConfigError` unless a structure has found a tuple of polygons of so many corners."""
    where = f"polygon.structure {name!r}"
    if not isinstance(found, tuple) or not all(isinstance(polygon, Polygon) for polygon in found):
        raise ConfigError(f"{where}: gave {shown(found)}, a tuple of Polygon expected")
    for polygon in found:
        require_arrays(polygon, {"corners": IDS}, np.shape(polygon.corners)[:1], where, ConfigError)
        require_arrays(polygon, {"intervals": FLOATS}, (*np.shape(polygon.intervals)[:1], 4), where, ConfigError)
        _check_ring(polygon.corners.tolist(), corners, where)
        _check_intervals(polygon.intervals, len(polygon.corners), where)


def _check_ring(ring: list[int], corners: int, where: str) -> None:
    """Raise `ConfigError` unless a polygon has three or more of so many corners, which are in order of bearing."""
    if len(ring) < 3 or len(set(ring)) < len(ring) or not set(ring) <= set(range(corners)):
        raise ConfigError(f"{where}: corners {shown(ring)}, three or more different ones of {corners} expected")
    if ring != sorted(ring):
        raise ConfigError(f"{where}: corners {shown(ring)}, counter-clockwise from the smallest expected")


def _check_intervals(intervals: Array, edges: int, where: str) -> None:
    """Raise `ConfigError` unless intervals (m,4) are of so many edges, in their order, and each has a label."""
    edge, begin, end, label = intervals.T
    if not np.isin(edge, np.arange(edges)).all() or not (np.diff(edge) >= 0.0).all():
        expected = f"whole numbers from 0 to {edges - 1}, ascending, expected"
        raise ConfigError(f"{where}: intervals of edges {shown(edge.tolist())}, {expected}")
    if not ((begin >= 0.0) & (begin < end) & (end <= 1.0) & np.isin(label, list(EdgeLabel))).all():
        raise ConfigError(f"{where}: intervals {shown(intervals.tolist())}, shares and an EdgeLabel expected")


def check_belief(belief: Belief, landmarks: Ints, after: str) -> Belief:
    """`belief` itself. Raises `FilterError` unless it is a Gaussian of the pose and of the `landmarks`, in any order.

    `after` is what the filter did before.
    """
    n = len(landmarks)
    shapes: dict[str, tuple[int, ...]] = {"T_map_robot": (3,), "pose_cov": (3, 3), "p_map": (n, 2), "covs": (n, 2, 2)}
    for name, shape in shapes.items():
        require_arrays(belief, {name: FLOATS}, shape, "belief", FilterError)
    require_arrays(belief, {"ids": IDS}, (n,), "belief", FilterError)
    if not np.array_equal(np.sort(belief.ids), np.sort(landmarks)):
        given, expected = shown(belief.ids.tolist()), shown(landmarks.tolist())
        raise FilterError(f"belief.ids: {given}, the landmarks {expected} expected")
    for numbers in (belief.T_map_robot, belief.p_map, belief.pose_cov, belief.covs):
        if not np.isfinite(numbers).all():
            raise FilterError(f"{after}: a number is not finite")
    if max(np.abs(belief.T_map_robot[:2]).max(), np.abs(belief.p_map).max(initial=0.0)) >= FAR:
        raise FilterError(f"{after}: a place {FAR} m away, or further")
    for cov in (belief.pose_cov, belief.covs):
        _check_cov(cov, after)
    return belief


def _check_cov(cov: Array, after: str) -> None:
    """Raise `FilterError` unless covariances (...,k,k) are symmetric and have no negative eigenvalue."""
    rounding = ROUNDING * np.abs(cov).max(initial=0.0)
    if (np.abs(cov - np.swapaxes(cov, -1, -2)) > rounding).any():
        raise FilterError(f"{after}: a covariance is not symmetric")
    if np.linalg.eigvalsh(cov).min(initial=0.0) < -rounding:
        raise FilterError(f"{after}: a covariance is not positive")
