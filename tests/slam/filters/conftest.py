"""Random lives of filters, of one beside its reference implementation, and measurements of correlated corners."""

from typing import Any

import numpy as np
import pytest

from mecp_env.core.sensors import Odometry
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import make_filter
from tests.slam import make
from tests.slam.filters.twin import J, Twin, expected, rotation


@pytest.fixture(params=["riekf", "ekf", "fej"])
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def random_cov(rng: np.random.Generator, sigmas: Any) -> Any:
    """A full covariance with these standard deviations and random correlations."""
    B = rng.normal(size=(len(sigmas), len(sigmas))) + 2.0 * np.eye(len(sigmas))
    cov = B @ B.T
    scale = np.asarray(sigmas) / np.sqrt(np.diag(cov))
    return cov * np.outer(scale, scale)


def random_odometry(rng: np.random.Generator, arcs: int = 4, bumper: bool = False) -> Odometry:
    cov = np.array([random_cov(rng, [0.02, 0.02]) for _ in range(arcs)])
    return make.odometry(rng.normal(size=(arcs, 2)) * [0.2, 0.3], cov=cov, bumper=bumper)


def sensor_cov(rng: np.random.Generator, count: int) -> Any:
    return random_cov(rng, np.tile([0.05, 0.01], count))


class Life:
    """Filters with the same random life; measurements are near what the first one expects."""

    def __init__(self, *filters: Any, seed: int) -> None:
        self.filters, self.rng, self.born = filters, np.random.default_rng(seed), 0

    def live(self, *steps: str) -> None:
        for step in steps:
            getattr(self, step)()

    def each(self, name: str, *arguments: Any) -> list[Any]:
        return [getattr(some, name)(*arguments) for some in self.filters]

    def predict(self, bumper: bool = False) -> None:
        self.each("predict", random_odometry(self.rng, int(self.rng.integers(1, 4)), bumper))

    def slip(self) -> None:
        self.predict(bumper=True)

    def augment(self, count: int = 0) -> None:
        """New landmarks; by default a random number of them."""
        m = count or int(self.rng.integers(1, 6))
        z = np.column_stack((self.rng.uniform(1.0, 9.0, m), self.rng.uniform(-np.pi, np.pi, m)))
        self.each("augment", z, sensor_cov(self.rng, m), 100 + 3 * (self.born + np.arange(m)))
        self.born += m

    def look(self, ids: Any, sharp: float = 1.0) -> tuple[Any, Any]:
        nu, _ = self.filters[0].innovation(np.zeros((len(ids), 2)), np.eye(2 * len(ids)), ids)
        z = -nu.reshape(-1, 2) + sharp * self.rng.normal(size=(len(ids), 2)) * [0.05, 0.01]
        return z, sharp**2 * sensor_cov(self.rng, len(ids))

    def update(self, count: int = 5, iterate: bool = False, sharp: float = 1.0) -> None:
        ids = self.rng.permutation(self.filters[0].ids)[:count]
        self.each("update", *self.look(ids, sharp), ids, iterate)

    def iterate(self) -> None:
        self.update(iterate=True)

    def sharp(self) -> None:
        self.update(sharp=1e-3)

    def merge(self) -> None:
        """The two nearest landmarks become one."""
        belief = self.filters[0].belief()
        if len(belief.ids) >= 2:
            distance = np.hypot(*(belief.p_map[:, None] - belief.p_map).transpose(2, 0, 1))
            np.fill_diagonal(distance, np.inf)
            i, j = np.unravel_index(distance.argmin(), distance.shape)
            self.each("fuse", int(belief.ids[i]), int(belief.ids[j]))

    def remove(self) -> None:
        self.each("remove", self.rng.permutation(self.filters[0].ids)[:2])

    def pin(self) -> None:
        self.each("set_pose", self.filters[0].belief().T_map_robot + self.rng.normal(size=3) * 0.01)

    def place(self) -> None:
        self.each("set_pose", self.rng.normal(size=3), random_cov(self.rng, [0.3, 0.2, 0.1]))

    def loosen(self) -> None:
        self.each("loosen", random_cov(self.rng, [0.1, 0.2, 0.05]))

    def shift(self) -> None:
        self.each("shift_pose", self.rng.normal(size=3) * 0.03)

    def copied(self) -> None:
        """Copies go on in place of the filters."""
        self.filters = tuple(self.each("copy"))


class Pair(Life):
    """A filter and its reference implementation with the same inputs."""

    def __init__(self, kind: str, seed: int, landmarks: int = 6) -> None:
        config = FilterConfig(kind=kind)
        super().__init__(make_filter(config), Twin(config), seed=seed)
        self.filter, self.twin = self.filters
        self.predict()
        self.augment(landmarks)
        self.slip()

    @property
    def ids(self) -> Any:
        return self.filter.ids

    @property
    def mean(self) -> Any:
        return self.filter.mean[: self.filter.size]

    @property
    def cov(self) -> Any:
        return self.filter.cov[: self.filter.size, : self.filter.size]

    def scan(self, count: int) -> tuple[Any, Any, Any]:
        """z, R and ids of distinct landmarks."""
        ids = self.rng.permutation(self.ids)[:count]
        return *self.look(ids), ids


@pytest.fixture
def pair(kind: str) -> Pair:
    return Pair(kind, seed=5)


def lost(kind: str, heading_error: float, seed: int = 0) -> tuple[Pair, Any, Any]:
    """A robot that turned wrongly six metres ago (its covariance knows), z and R of what it now sees of 5 landmarks."""
    pair = Pair(kind, seed, landmarks=5)
    true, swing = pair.twin.x.copy(), np.zeros(13)
    from_pivot = np.array([6.0, 0.0])
    true[0] += heading_error
    true[1:3] += rotation(heading_error) @ from_pivot - from_pivot
    swing[:2], swing[2] = J @ from_pivot, 1.0  # of x, y and heading, per radian
    pair.twin.set_world_cov(pair.twin.world_cov() + 0.3**2 * np.outer(swing, swing))
    pair.cov[:] = pair.twin.P
    return pair, expected(true, np.arange(5)), np.diag(np.tile([0.02**2, 0.005**2], 5))
