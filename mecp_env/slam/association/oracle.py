"""The upper bound `known`: association from ground truth (estimator="known")."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from mecp_env.core.carriers import Ints
from mecp_env.slam.association.gating import GatedAssociator, MatchBuilder
from mecp_env.slam.messages import NO_ID, Corners, Decision, FeatureState, MapView, Match, Polygon, Reason
from mecp_env.slam.protocols import Filter


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
class OracleAssociator(GatedAssociator):
    """Pairs each corner with the feature that was initialised from the same true corner.

    The owner of the ground truth sets `correspondences` before each scan: plain data, so that a state can hold it.
    """

    certain = True
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
            outside = pairs[nis > self.gate]
            builder.assign(outside, Decision.IGNORED, Reason.REFUSED)
        return builder

    def remember(self, match: Match) -> None:
        """Note which new feature was initialised from which true corner."""
        new = match.decision == int(Decision.NEW)
        self.feature_of.update(zip(self.true_corner[new].tolist(), match.ids[new].tolist(), strict=True))
