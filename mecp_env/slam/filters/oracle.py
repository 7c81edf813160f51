"""A known pose: ground truth in place of the estimated pose, an upper bound (estimator="truth")."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.sensors import Odometry
from mecp_env.slam.protocols import Filter


@dataclass(slots=True, eq=False)
class OraclePoseFilter:
    """The filter `inner`, except that each prediction ends at the true pose.

    The owner of the ground truth sets `T_map_robot` before each step, of this filter and of its copies at once.
    """

    inner: Filter
    truth: Array = field(default_factory=lambda: np.zeros(3))  # (3,) m, m, rad; the copies have the same

    @property
    def T_map_robot(self) -> Array:
        """The true pose (3,)."""
        return self.truth

    @T_map_robot.setter
    def T_map_robot(self, T_map_robot: Array) -> None:
        self.truth[:] = T_map_robot

    def predict(self, odometry: Odometry) -> None:
        self.inner.predict(odometry)
        self.inner.set_pose(self.T_map_robot)

    def set_pose(self, T_map_robot: Array, pose_cov: Array | None = None) -> None:
        """Nothing: the pose is the true one."""

    def loosen(self, pose_cov: Array) -> None:
        """Nothing: the pose is the true one."""

    def log_bayes_factor(self, z: Array, R: Array, ids: Ints, pose_cov: Array) -> float:
        """0: the true pose cannot be loosened."""
        return 0.0

    def copy(self) -> Self:
        """A filter with a map of its own, at the same true pose."""
        return replace(self, inner=self.inner.copy())

    def __getattr__(self, name: str) -> Any:
        if name in self.__slots__ or name.startswith("__"):  # absent while a copy is made
            raise AttributeError(name)
        return getattr(self.inner, name)
