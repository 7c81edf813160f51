"""Nearest neighbour within the room: what rooms alone are worth."""

from __future__ import annotations

from dataclasses import dataclass

from mecp_env.slam.association.nearest import pair_masked
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import Corners, MapView, Match, Polygon
from mecp_env.slam.protocols import Associator, Filter


@dataclass(slots=True, eq=False)
class NearestRoomAssociator(Associator):
    """As `nearest` among the landmarks of the room; of all where no landmark of the room is inside the gate.

    Never by descriptors or polygons, whatever the switches are.
    """

    config: AssociationConfig

    def __post_init__(self) -> None:
        self.config = self.config.model_copy(update={"use_rooms": True, "use_descriptor": False})

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision per corner."""
        return pair_masked(corners, view, belief, self.config)
