"""Where a laser sits on the robot, what it sees, and how noisy it is: the same for the world and estimator."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from pydantic import Field

from mecp_env.core.array_types import Array
from mecp_env.core.settings import Settings

SEEN_NEAR_M = 0.3  # even a weak laser sees what is as near


class LaserView(Settings):
    """Field of view and mounting pose of a laser: physical data, not for tuning."""

    field_of_view_deg: float = Field(360.0, ge=10.0, le=360.0)  # centred on the laser's heading
    x_m: float = Field(0.0, ge=-2.0, le=2.0)  # of the laser in the robot's frame: ahead of its centre
    y_m: float = Field(0.0, ge=-2.0, le=2.0)  # to the left of it
    heading_deg: float = Field(0.0, ge=-180.0, le=180.0)  # counter-clockwise from straight ahead

    @property
    def field_of_view_rad(self) -> float:
        return math.radians(self.field_of_view_deg)

    @property
    def is_centred(self) -> bool:
        """True when the laser's frame is the robot's."""
        return self.x_m == 0.0 and self.y_m == 0.0 and self.heading_deg == 0.0

    @property
    def T_robot_laser(self) -> Array:
        """(3,) m, rad: the pose of the laser in the robot's frame."""
        return np.array([self.x_m, self.y_m, math.radians(self.heading_deg)])


class LaserNoise(LaserView):
    """Also the noise of one beam (IV: sigma_r = 0.05 m, sigma_theta = 0.3 deg), and which beams do not return."""

    range_sigma_m: float = Field(0.05, ge=0.0, le=1.0)  # of a range, or
    range_sigma_share: float = Field(0.0, ge=0.0, le=0.5)  # this share of it, whichever is larger
    bearing_sigma_deg: float = Field(0.3, ge=0.0, le=5.0)
    grazing_deg: float = Field(90.0, gt=45.0, le=90.0)  # incidence (from the normal) beyond which nothing returns
    no_return: Literal["free", "unknown"] = "free"
    """What a beam without a return says: nothing is within the range, or (a weak laser) a wall may be there unseen."""
    dark_dropout: float = Field(0.0, ge=0.0, lt=1.0)  # share of the beams that does not return from a dark surface

    @property
    def free_without_return_m(self) -> float:
        """How far the floor is free along a beam that does not return, within the range of the laser."""
        return math.inf if self.no_return == "free" else SEEN_NEAR_M

    @property
    def bearing_sigma_rad(self) -> float:
        return math.radians(self.bearing_sigma_deg)
