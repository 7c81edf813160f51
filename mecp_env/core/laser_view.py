"""Where a laser sits on the robot and which part of its surroundings it sees: the same for the world and estimator."""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from mecp_env.core.array_types import Array
from mecp_env.core.settings import Settings


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
