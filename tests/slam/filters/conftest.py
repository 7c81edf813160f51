"""A filter with a map, and random measurements with correlated corners."""

from typing import Any

import numpy as np
import pytest

from mecp_env.core.sensors import Odometry
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import make_filter
from tests.slam import make
from tests.slam.filters.twin import Twin, expected


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


class Pair:
    """A filter and its reference implementation with the same inputs."""

    def __init__(self, kind: str, seed: int, landmarks: int = 6) -> None:
        self.rng = np.random.default_rng(seed)
        config = FilterConfig(kind=kind)
        self.filter: Any = make_filter(config)
        self.twin = Twin(kind, config)
        self.ids = np.empty(0, np.int64)
        self.predict()
        self.augment(landmarks)
        self.predict(bumper=True)

    def predict(self, bumper: bool = False) -> None:
        odometry = random_odometry(self.rng, int(self.rng.integers(1, 5)), bumper)
        self.filter.predict(odometry)
        self.twin.predict(odometry)

    def augment(self, count: int) -> None:
        z = np.stack([self.rng.uniform(1, 8, count), self.rng.uniform(-np.pi, np.pi, count)], axis=1)
        R = sensor_cov(self.rng, count)
        ids = 100 + 3 * (len(self.ids) + np.arange(count))
        self.filter.augment(z, R, ids)
        self.twin.augment(z, R)
        self.ids = np.concatenate([self.ids, ids])

    def scan(self, count: int) -> tuple[Any, Any, Any]:
        """z, R and slots of distinct landmarks."""
        slots = self.rng.permutation(len(self.ids))[:count]
        z = expected(self.twin.x, slots) + self.rng.normal(size=(count, 2)) * [0.05, 0.01]
        return z, sensor_cov(self.rng, count), slots

    def update(self, count: int) -> None:
        z, R, slots = self.scan(count)
        self.filter.update(z, R, self.ids[slots])
        self.twin.update(z, R, slots)

    @property
    def mean(self) -> Any:
        return self.filter.mean[: self.filter.size]

    @property
    def cov(self) -> Any:
        return self.filter.cov[: self.filter.size, : self.filter.size]


@pytest.fixture
def pair(kind: str) -> Pair:
    return Pair(kind, seed=5)
