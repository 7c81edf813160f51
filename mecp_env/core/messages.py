"""What the sensors measure in one control step: the input of the estimator.

Lengths are in metres, angles in radians counter-clockwise in (-pi, pi], float64.
"""

from __future__ import annotations

from dataclasses import dataclass

from mecp_env.core.array_types import Array, Bools
from mecp_env.core.quick import quick


@quick
@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """A burst of K sweeps of B beams, all taken at the pose that ends the step (IV; dense scan of III-A.1)."""

    ranges: Array  # (K,B) m; max_range_m where nothing was hit
    bearings: Array  # (K,B) rad, robot frame, nominal, ascending in each sweep in (-pi, pi]
    hit: Bools  # (K,B)
    max_range_m: float


@quick
@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """The body motion of one control step as measured: M arcs one after the other."""

    increments: Array  # (M,2) m, rad: distance along the mean heading of the arc, turn
    cov: Array  # (M,2,2) covariance of each increment
    bumper: bool  # the robot touched something in this step: it may have slipped sideways
