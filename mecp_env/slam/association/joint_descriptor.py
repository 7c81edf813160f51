"""Greedy joint compatibility with the corner descriptor: `mecp` in one pass and without polygons."""

from __future__ import annotations

from dataclasses import dataclass

from mecp_env.slam.association.match_builder import MatchBuilder
from mecp_env.slam.association.mecp import MecpAssociator
from mecp_env.slam.messages import Corners, MapView, Match, Polygon
from mecp_env.slam.protocols import Filter


@dataclass(slots=True, eq=False)
class JointDescriptorAssociator(MecpAssociator):
    """Pairs are accepted one by one at the prediction, each given those before it (joint_compatibility.py).

    Descriptors and rooms are switches.
    """

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision per corner."""
        if not (len(view.belief.ids) and len(corners)):
            return MatchBuilder(len(corners)).match()
        return self._paired(corners, (), view, belief).match()
