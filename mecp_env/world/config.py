"""Configuration of the true world: robot, laser, odometry, pedestrians and clutter.

Wheels that exist: fields of `OdometryConfig` by name (sources: docs/sensors.md).
"""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from mecp_env.core.carriers import Array
from mecp_env.core.sensors import LASERS, LaserNoise
from mecp_env.core.settings import PresetSettings, Settings

WHEELS: dict[str, dict[str, Any]] = {
    "paper": {},  # IV: the defaults of the fields
    "pioneer": {"distance_sigma_m": 0.0035, "turn_sigma_deg": 1.2, "turn_m": 0.26},  # differential drive
    "turtlebot": {"distance_sigma_m": 0.007, "turn_sigma_deg": 0.5, "turn_m": 1.0},  # differential drive, gyroscope
    "skid_steer": {  # four wheels that slide sideways in every turn
        "distance_sigma_m": 0.02,
        "turn_sigma_deg": 3.0,
        "turn_m": 2.0,
        "slip_share": 0.01,
    },
}


def ordered(limits: tuple[float, float]) -> tuple[float, float]:
    """`limits` themselves. Raises `ValueError` when the first is larger."""
    if limits[0] > limits[1]:
        raise ValueError(f"expected least <= most, given {limits[0]:g}, {limits[1]:g}")
    return limits


Metres = Annotated[float, Field(ge=0.1, le=2.0)]
Speed = Annotated[float, Field(ge=0.05, le=2.0)]
Seconds = Annotated[float, Field(ge=0.0, le=600.0)]
Sizes = Annotated[tuple[Metres, Metres], AfterValidator(ordered)]
Speeds = Annotated[tuple[Speed, Speed], AfterValidator(ordered)]
Times = Annotated[tuple[Seconds, Seconds], AfterValidator(ordered)]


class RobotConfig(Settings):
    """A circular differential-drive robot; the defaults are those of the paper's Pioneer P3-DX."""

    radius_m: float = Field(0.22, ge=0.05, le=2.0)
    max_speed_m_s: float = Field(0.75, gt=0.0, le=5.0)
    max_turn_rad_s: float = Field(1.75, gt=0.0, le=10.0)
    max_acceleration_m_s2: float = Field(1.0, gt=0.0, le=100.0)
    max_turn_acceleration_rad_s2: float = Field(5.0, gt=0.0, le=1000.0)
    period_s: float = Field(0.4, gt=0.0, le=5.0)
    arcs: int = Field(4, ge=1, le=64)  # odometry readings in a step
    substeps: int = Field(4, ge=1, le=200)  # physics steps in an arc

    @property
    def substep_s(self) -> float:
        """Duration of a physics step, s."""
        return self.period_s / (self.arcs * self.substeps)

    @model_validator(mode="after")
    def _cannot_tunnel(self) -> Self:
        """Within a substep the robot moves less than a tenth of its radius, so that no wall is jumped."""
        stride = self.max_speed_m_s * self.substep_s
        if stride > 0.1 * self.radius_m:
            raise ValueError(
                f"substeps: one moves the robot {stride:g} m, at most a tenth of radius_m={self.radius_m:g}"
            )
        return self


class LaserConfig(LaserNoise, PresetSettings):
    """A laser scanner that takes a burst of sweeps at the end of a step (IV, III-A.1).

    A beam returns nothing beyond the largest range, from a face that it grazes, and sometimes from a dark wall.
    """

    PRESETS: ClassVar = LASERS

    preset: Literal["paper", "ideal", "lms200", "urg04lx", "utm30lx", "rplidar_a1"] = "paper"
    sweeps: int = Field(4, ge=1, le=8)
    beams: int = Field(720, ge=8, le=7200)  # over the field of view; paper: 720, one per 0.5 deg
    max_range_m: float = Field(30.0, gt=0.0, le=1000.0)
    dark_share: float = Field(0.0, ge=0.0, le=1.0)  # of the walls' faces, drawn for each episode, that are dark

    @property
    def loses_beams(self) -> bool:
        """True when a beam may hit a face in range and not return."""
        return self.grazing_deg < 90.0 or self.has_dark_walls

    @property
    def has_dark_walls(self) -> bool:
        """True when some beams are lost on dark walls."""
        return self.dark_share > 0.0 and self.dark_dropout > 0.0


QUARTER_TURN = math.pi / 2.0
READINGS = ("per_metre", "per_step", "linear")


class OdometryConfig(PresetSettings):
    """Noise of the measured body motion: the paper's sigma_rR and sigma_thetaR (IV) in one of three readings.

    `per_metre`: sigmas per square root of a metre of path; a turn of 90 deg counts as `turn_m` of path.
    `per_step`: sigmas of every control step in which the robot moves.
    `linear`: sigmas grow in proportion to the step's path (distance) and turn (heading).
    In a share of the steps the wheels slip, of which the covariance of the reading knows nothing.
    """

    PRESETS: ClassVar = WHEELS
    DERIVED: ClassVar = ("rule",)

    preset: Literal["paper", "pioneer", "turtlebot", "skid_steer"] = "paper"
    reading: Literal["per_metre", "per_step", "linear"] = "per_metre"
    distance_sigma_m: float = Field(0.1, ge=0.0, le=1.0)  # per sqrt(m), per step, or per metre
    turn_sigma_deg: float = Field(1.5, ge=0.0, le=30.0)  # per sqrt(m), per step, or per 90 deg and per metre
    turn_m: float = Field(0.5, ge=0.0, le=10.0)  # path equivalent of a turn of 90 deg
    scale: float = Field(1.0, ge=0.0, le=10.0)  # of all sigmas: 0 is perfect odometry
    slip_share: float = Field(0.0, ge=0.0, le=1.0)  # of the steps, in which
    slip_most: float = Field(3.0, ge=1.0, le=10.0)  # the measured distance is up to this many times the true one, and
    slip_turn_deg: float = Field(10.0, ge=0.0, le=90.0)  # the measured turn is off by an error of this sigma

    @property
    def rule(self) -> int:
        """The number of the reading."""
        return READINGS.index(self.reading)

    @property
    def turn_sigma_rad(self) -> float:
        """`turn_sigma_deg` in rad."""
        return math.radians(self.turn_sigma_deg)

    def sigmas(self, distance_m: float, turn_rad: float) -> Array:
        """(2,) m, rad: standard deviations of a motion of this path and turn, in the reading `per_metre`."""
        path = self.scale * math.sqrt(distance_m + self.turn_m * turn_rad / QUARTER_TURN)
        return np.array([path * self.distance_sigma_m, path * self.turn_sigma_rad])

    @property
    def slip_turn_rad(self) -> float:
        """`slip_turn_deg` in rad."""
        return math.radians(self.slip_turn_deg)


class CrowdConfig(Settings):
    """Pedestrians: round, each with a size and speed, walking from room to room along shortest paths."""

    people: int = Field(0, ge=0, le=50)  # at most; fewer if no more fit, see `summary()`
    radius_m: Sizes = (0.2, 0.3)
    speed_m_s: Speeds = (0.3, 1.2)
    pause_s: Times = (0.0, 5.0)  # how long a pedestrian stays at a destination
    polite: bool = True  # they avoid each other and the robot; otherwise they walk until they touch it


class ClutterConfig(Settings):
    """Deviations from the floor plan: boxes that the robot can push, doors that are closed for an episode."""

    movable_boxes: int = Field(0, ge=0, le=50)  # at most; fewer if no more fit, see `summary()`
    box_m: Sizes = (0.3, 0.6)  # length of a side
    closed_doors: float = Field(0.0, ge=0.0, le=1.0)  # probability of each door that is not at the start
    reachable_share: float = Field(0.8, ge=0.0, le=1.0)  # of the rooms at least; doors that would leave fewer stay open
