"""Association by true identities, handed in from outside: the upper bound (estimator="known")."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mecp_env.slam.association.base import undecided
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import NO_ID, Corners, Decision, FeatureState, MapView, Match, Polygon, Reason
from mecp_env.slam.protocols import Filter


@dataclass(slots=True, eq=False)
class OracleAssociator:
    """Pairs each corner with the feature first born from the same true corner; the caller tells who is who.

    `identities` (n,) is set before each scan by whoever knows the truth: the true corner of each corner, -1 for none.
    """

    config: AssociationConfig
    identities: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    feature_of: dict[int, int] = field(default_factory=dict)  # true corner -> feature id

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision a corner: its landmark or track if the true corner has one, new otherwise."""
        match = undecided(len(corners))
        for i, identity in enumerate(self.identities.tolist()):
            feature = self.feature_of.get(identity, NO_ID)
            if identity < 0 or (corners.beyond[i] >= 0 and feature == NO_ID):
                match.decision[i], match.reason[i] = int(Decision.IGNORED), int(Reason.IDENTITY)
            elif feature != NO_ID and view.features.state[feature] != int(FeatureState.DEAD):
                state = view.features.state[feature]
                landmark = state == int(FeatureState.LANDMARK)
                match.ids[i] = feature
                match.decision[i] = int(Decision.LANDMARK if landmark else Decision.PROVISIONAL)
                match.reason[i] = int(Reason.IDENTITY)
        return match

    def born(self, corner: int, feature: int) -> None:
        """Remember that corner `corner` of the last scan became the new feature `feature`."""
        self.feature_of[int(self.identities[corner])] = feature
