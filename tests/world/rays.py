"""Exact rays for the tests of the laser."""

import math

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.world.laser import _cast


def cast_rays(segments: Array, T_world_robot: Array, beams: int = 720) -> Array:
    """Exact ranges (B,) m from a pose (3,) to the faces (S,2,2) that it sees from their left; inf where there is none.

    Beam i has the bearing -pi + (i + 1) 2 pi / B in the robot's frame.
    """
    bearings = -math.pi + 2.0 * math.pi / beams * np.arange(1, beams + 1)
    directions = np.stack([np.cos(bearings), np.sin(bearings)])
    inverse = _cast(np.ascontiguousarray(segments), T_world_robot, directions, 2.0 * math.pi, 0.0)
    with np.errstate(divide="ignore"):
        ranges: Array = 1.0 / inverse
    return ranges
