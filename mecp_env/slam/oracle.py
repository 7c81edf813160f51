"""Ground truth in place of what is estimated, as an upper bound: correspondences ("known"), and the pose ("truth")."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Protocol, Self

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.sensors import Odometry
from mecp_env.slam.association.gating import MatchBuilder, chi2_gate
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import NO_ID, Corners, Decision, FeatureState, MapView, Match, Polygon, Reason
from mecp_env.slam.protocols import Associator, Filter


class Correspondences(Protocol):
    """Ground truth about the corners of one scan."""

    def __call__(self, corners: Corners) -> Ints:
        """(n,) number of the true corner that each corner of the scan is, -1 for a false detection."""


@dataclass(frozen=True, slots=True, eq=False)
class NoCorrespondences:
    """Every corner is a false detection: what an `OracleAssociator` knows until it is given a source."""

    def __call__(self, corners: Corners) -> Ints:
        """(n,) of -1."""
        return np.full(len(corners), -1)


@dataclass(slots=True, eq=False)
class OracleAssociator(Associator):
    """Pairs each corner with the feature that was initialised from the same true corner.

    The owner of the ground truth sets `correspondences` before each scan: plain data, so that a state can hold it.
    """

    certain = True
    config: AssociationConfig
    correspondences: Correspondences = field(default_factory=NoCorrespondences)
    true_corner: Ints = field(default_factory=lambda: np.empty(0, np.int64))  # (n,) of each corner of the last scan
    feature_of: dict[int, int] = field(default_factory=dict)  # true corner -> feature id

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision per corner: its landmark or track if the true corner has one, new otherwise."""
        builder, state = MatchBuilder(len(corners)), view.features.rows["state"]
        self.true_corner = self.correspondences(corners)
        for i, true_corner in enumerate(self.true_corner.tolist()):
            feature = self.feature_of.get(true_corner, NO_ID)
            if true_corner < 0:
                builder.assign(i, Decision.IGNORED, Reason.IDENTITY)
            elif feature != NO_ID and state[feature] != int(FeatureState.DEAD):
                landmark = state[feature] == int(FeatureState.LANDMARK)
                decision = Decision.LANDMARK if landmark else Decision.PROVISIONAL
                builder.assign(i, decision, Reason.IDENTITY, feature)
        return self._without_outliers(builder, corners, belief).match()

    def _without_outliers(self, builder: MatchBuilder, corners: Corners, belief: Filter) -> MatchBuilder:
        """The same without pairs that are no measurement of their landmark: at the pose that all pairs imply."""
        pairs = np.flatnonzero(builder.rows["decision"] == Decision.LANDMARK)
        if len(pairs):
            ids, implied = builder.rows["id"][pairs], belief.copy()
            implied.update(*corners.measurements(pairs), ids, iterate=True)
            nis = implied.individual_nis(corners.z[pairs], corners.R[pairs], ids).diagonal()
            outside = pairs[nis > chi2_gate(2, self.config.gate_probability)]
            builder.assign(outside, Decision.IGNORED, Reason.REFUSED)
        return builder

    def remember(self, match: Match) -> None:
        """Note which new feature was initialised from which true corner."""
        new = match.decision == int(Decision.NEW)
        self.feature_of.update(zip(self.true_corner[new].tolist(), match.ids[new].tolist(), strict=True))


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
