"""Nearest neighbour with the corner descriptor: what descriptors alone are worth."""

from __future__ import annotations

from dataclasses import dataclass

from mecp_env.slam.association.nearest import pair_masked
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import Corners, MapView, Match, Polygon
from mecp_env.slam.protocols import Associator, Filter


@dataclass(slots=True, eq=False)
class NearestDescriptorAssociator(Associator):
    """As `nearest` among the landmarks of the whole map whose descriptor is that of the corner.

    Never by rooms or polygons, whatever the switches are.
    """

    config: AssociationConfig

    def __post_init__(self) -> None:
        self.config = self.config.model_copy(update={"use_rooms": False, "use_descriptor": True})

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision per corner."""
        return pair_masked(corners, view, belief, self.config)
