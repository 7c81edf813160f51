"""What the stages of rooms and doors ask of a configuration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from mecp_env.slam.config import SlamConfig


@dataclass(frozen=True, slots=True)
class RoomLimits:
    """The limits of rooms and doors."""

    confirm_sightings: int  # of a door, as many as make a landmark
    wall_thickness_m: float  # of the thickest wall
    doorway_m: float  # the robot is in a doorway up to here; also between the places of its path that are kept
    recognise_m: float  # two polygons recognised this far apart merge rooms
    recognise_corners: int
    trail_places: int

    @classmethod
    def of(cls, config: SlamConfig) -> Self:
        """The limits that a configuration implies."""
        rooms = config.rooms
        of_others = config.tracks.sightings, config.corners.wall_thickness_m
        return cls(*of_others, rooms.doorway_m, config.grid.key_scan_m, rooms.recognise_corners, rooms.trail_places)

    @property
    def recognise_by_corners_m(self) -> float:
        """The same as `recognise_m` for single corners, a weaker sign: three times as far apart."""
        return 3.0 * self.recognise_m

    @property
    def same_gap_m(self) -> float:
        """Two gaps whose middles are nearer than this are one: the two faces of a door in the thickest wall."""
        return self.wall_thickness_m

    @property
    def behind_wall_m(self) -> float:
        """A corner this far behind the middle of a door's wall is beyond the door."""
        return self.wall_thickness_m / 2.0
