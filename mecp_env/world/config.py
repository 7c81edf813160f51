"""Configuration of the true world: robot, laser, odometry, pedestrians and clutter.

Wheels that exist: fields of `OdometryConfig` by name (sources: docs/sensors.md).

The specification of a generated building, the presets, and the seeds of the splits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from mecp_env.core.carriers import Array
from mecp_env.core.errors import ConfigError
from mecp_env.core.sensors import LASERS, LaserNoise
from mecp_env.core.settings import PresetSettings, Settings, as_many, as_range, guess, shown

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

    def sigmas(self, distance_m: float, turn_rad: float) -> Array:
        """(2,) m, rad: standard deviations of a motion of this path and turn, in the reading `per_metre`."""
        path = self.scale * math.sqrt(distance_m + self.turn_m * turn_rad / QUARTER_TURN)
        return np.array([path * self.distance_sigma_m, path * math.radians(self.turn_sigma_deg)])


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


Difficulty = Literal["easy", "medium", "hard", "huge"]
Shape = Literal["L", "T", "U"]
Piece = Literal["shelf", "box", "square_pillar", "round_pillar"]
Single, Ordered, Word = BeforeValidator(as_range), AfterValidator(ordered), BeforeValidator(as_many)
Side = Annotated[float, Field(ge=2.4, le=15.0)]
Thickness = Annotated[float, Field(ge=0.05, le=0.4)]
Width = Annotated[float, Field(ge=0.6, le=2.0)]
Turn = Annotated[float, Field(ge=-180.0, le=180.0)]
Shapes = Annotated[tuple[Shape, ...], Field(min_length=1, fail_fast=True), Word]

ROOMS_OF = {"rectangle": 1, "L": 2, "U": 2, "T": 3, "yard": 0}  # a shape with those that fill its notches

# seeds of the buildings; train on the first, select on the second, report on the third
SPLITS: dict[str, range] = {
    "train": range(1_000_000),
    "validation": range(1_000_000, 1_001_000),
    "test": range(2_000_000, 2_001_000),
}


@dataclass(eq=False)
class Rejected(Exception):
    """Why a try failed: the field that it could not meet, and the value that it reached."""

    field: str
    most: float = 0.0


class GeneratorSpec(Settings):
    """A building to generate; ranges (low, high) are drawn from evenly, a single number is the range of itself.

    Rooms, doors, corridors, shapes and slanted corners come out exactly, furniture within 15 % (or the nearest whole
    piece); a specification of which no building can be found is refused.
    """

    rooms: int = Field(8, ge=2, le=200)  # corridors are rooms too
    loops: int = Field(0, ge=0, le=100)  # doors beyond those that join all rooms: rooms - 1 + loops doors
    corridors: int = Field(0, ge=0, le=40)  # of the rooms so many; at most one for three others
    corridor_width_m: Annotated[tuple[Width, Width], Single, Ordered] = (1.6, 2.0)  # between the middles of its walls
    room_side_m: Annotated[tuple[Side, Side], Single, Ordered] = (3.2, 5.5)  # the side of a square of the room's area
    shaped_rooms: int = Field(0, ge=0, le=60)  # rooms that are not rectangles
    shapes: Shapes = ("L", "T", "U")  # what those may be
    yards: int = Field(0, ge=0, le=10)  # parts of the plot that are not built on
    slanted_corners: int = Field(0, ge=0, le=3)  # outer corners of the building cut off by a slanted wall
    turned_deg: Annotated[tuple[Turn, Turn], Single, Ordered] = (0.0, 0.0)  # the whole building against the axes
    wall_thickness_m: Annotated[tuple[Thickness, Thickness], Single, Ordered] = (0.12, 0.12)  # one for the building
    door_width_m: Annotated[tuple[Width, Width], Single, Ordered] = (0.9, 0.9)  # drawn for each door
    max_doors: int = Field(4, ge=1, le=20)  # of a room; corridors may have any number
    # pieces on 10 m^2 of rooms, none in corridors; in rooms of 3.2-5.5 m about 2 find room (boxes 1), over 6 m 3
    furniture: float = Field(0.0, ge=0.0, le=3.0)
    # what the furniture may be
    pieces: Annotated[tuple[Piece, ...], Field(min_length=1, fail_fast=True), Word] = (
        "shelf",
        "box",
        "square_pillar",
        "round_pillar",
    )

    @classmethod
    def preset(cls, difficulty: str = "medium", **fields: Any) -> Self:
        """The specification of a difficulty, with `fields` over it. Raises `ConfigError` for an unknown one."""
        if not isinstance(difficulty, str) or difficulty not in DIFFICULTIES:
            known, nearest = ", ".join(DIFFICULTIES), guess(difficulty, DIFFICULTIES)
            raise ConfigError(f"difficulty: {shown(difficulty)} is not one of {known}{nearest}")
        return cls(**(DIFFICULTIES[difficulty] | fields))

    @model_validator(mode="after")
    def _fits(self) -> Self:
        plain = self.rooms - self.corridors
        needed = self.shaped_rooms * max(ROOMS_OF[shape] for shape in self.shapes)
        if needed > plain:
            raise ValueError(f"shaped_rooms: {self.shaped_rooms} with their notches need {needed} rooms, {plain} left")
        if self.corridors and plain < 3 * self.corridors:
            raise ValueError(f"corridors: {self.corridors}, at most one for three rooms beside them")
        width, side = self.door_width_m[1], self.room_side_m[0]
        if width > side - 1.5:
            raise ValueError(f"door_width_m: up to {width:g} m is too wide for rooms of {side:g} m")
        return self

    def require_doors(self) -> None:
        """Raise `ConfigError` for doors that no plan can have.

        No two join the same rooms, and the plan is flat: one of n rooms has at most 3n - 6 doors (Euler).
        """
        ends = (self.rooms - self.corridors) * self.max_doors + self.corridors * (self.rooms - 1)
        least, most = self.rooms - 1, min(max(3 * self.rooms - 6, 1), ends // 2)
        if most < least:
            raise ConfigError(f"max_doors: {self.max_doors}, too few to join {self.rooms} rooms")
        if self.loops > most - least:
            raise ConfigError(
                f"loops: {self.loops} loops, at most {most - least} with {self.rooms} rooms on one floor, "
                f"{self.corridors} of them corridors, the others of at most {self.max_doors} doors each"
            )


DIFFICULTIES: dict[str, dict[str, Any]] = {
    "easy": {"rooms": 4, "room_side_m": (3.5, 6.0)},
    "medium": {"rooms": 8, "loops": 1, "corridors": 1, "shaped_rooms": 1, "furniture": 0.3},
    "hard": {
        "rooms": 14,
        "loops": 3,
        "corridors": 2,
        "shaped_rooms": 3,
        "yards": 1,
        "slanted_corners": 2,
        "turned_deg": (-45.0, 45.0),
        "wall_thickness_m": (0.1, 0.2),
        "door_width_m": (0.8, 1.0),
        "furniture": 0.8,
    },
    "huge": {
        "rooms": 40,
        "loops": 8,
        "corridors": 4,
        "shaped_rooms": 6,
        "yards": 2,
        "slanted_corners": 2,
        "turned_deg": (-45.0, 45.0),
        "furniture": 0.5,
    },
}


def split_seed(split: str, index: int) -> int:
    """The seed of building `index` of a split. Raises `ConfigError` for an unknown split or an index outside."""
    if not isinstance(split, str) or split not in SPLITS:
        raise ConfigError(f"split: {shown(split)} is not one of {', '.join(SPLITS)}{guess(split, SPLITS)}")
    if not 0 <= index < len(SPLITS[split]):
        raise ConfigError(f"index: {index}, split {split!r} has {len(SPLITS[split])} buildings")
    return SPLITS[split][index]
