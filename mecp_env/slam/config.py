"""Configuration of the estimator: one frozen section a stage, the paper's value named beside each."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field

from mecp_env.settings import Settings


class SensorModel(Settings):
    """What the estimator believes of its laser (IV: sigma_r = 0.05 m, sigma_theta = 0.3 deg)."""

    range_sigma_m: float = Field(0.05, ge=0.0, le=1.0)
    bearing_sigma_deg: float = Field(0.3, ge=0.0, le=5.0)

    @property
    def bearing_sigma_rad(self) -> float:
        return math.radians(self.bearing_sigma_deg)


class ClusteringConfig(Settings):
    """III-A.1, data clustering."""

    threshold: Literal["adaptive_noise", "adaptive", "fixed"] = "adaptive_noise"  # paper: "adaptive"
    grazing_deg: float = Field(85.0, gt=45.0, lt=90.0)  # paper: 85
    noise_sigmas: float = Field(3.0, ge=0.0, le=10.0)  # paper: none
    fixed_m: float = Field(0.3, gt=0.0, le=5.0)


class SegmentConfig(Settings):
    """III-A.1, Ramer-Douglas-Peucker and the line fit."""

    min_beams: int = Field(5, ge=3, le=100)
    min_length_m: float = Field(0.25, gt=0.0, le=5.0)


class CornerConfig(Settings):
    """III-A.1, crossings and free ends; door jambs (III: fixed unique width for doors)."""

    door_width_m: tuple[float, float] = (0.75, 1.05)
    door_range_m: float = Field(3.0, gt=0.0, le=30.0)
    door_incidence_deg: float = Field(30.0, gt=0.0, lt=90.0)


class PolygonConfig(Settings):
    """III-A.2, the Maximum Empty Convex Polygon."""

    tolerance_sigmas: float = Field(2.5, ge=0.0, le=10.0)  # paper: none
    guard: bool = True  # paper: none
    guard_beams: int = Field(3, ge=1, le=100)
    guard_m: float = Field(0.2, gt=0.0, le=5.0)
    keep_ties: int = Field(2, ge=1, le=4)  # paper: "both of them are considered"
    open_depth_m: float = Field(0.2, gt=0.0, le=2.0)
    open_width_m: float = Field(0.4, gt=0.0, le=5.0)


class TrackConfig(Settings):
    """From a corner seen once to a landmark."""

    sightings: int = Field(3, ge=1, le=20)
    jamb_sightings: int = Field(2, ge=1, le=20)
    window_periods: int = Field(10, ge=1, le=1000)


class AssociationConfig(Settings):
    """III-B, data association."""

    method: Literal["mecp", "mecp_paper", "nearest", "known"] = "mecp"
    use_polygons: bool = True
    use_rooms: bool = True
    use_signature: bool = True  # paper: none
    gate_probability: float = Field(0.999, gt=0.5, lt=1.0)
    signature_deg: float = Field(40.0, gt=0.0, le=180.0)
    polygons_per_room: int = Field(32, ge=1, le=1000)


class FilterConfig(Settings):
    """The filter (paper: EKF-SLAM, "ekf")."""

    kind: Literal["riekf", "ekf"] = "riekf"
    prior_sigma_m: float = Field(0.001, gt=0.0, le=10.0)
    prior_sigma_rad: float = Field(1e-4, gt=0.0, le=3.0)
    bumper_lateral_sigma_m: float = Field(0.05, ge=0.0, le=1.0)
    bumper_heading_sigma_deg: float = Field(3.0, ge=0.0, le=90.0)
    closure_iterations: int = Field(5, ge=1, le=20)
    closure_gap_periods: int = Field(10, ge=1, le=10_000)
    max_landmarks: int = Field(1024, ge=8, le=10_000)
    diverged_sigma_m: float = Field(5.0, gt=0.0, le=1000.0)


class RoomConfig(Settings):
    """III, rooms and doors."""

    confirm_sightings: int = Field(3, ge=1, le=50)
    wall_thickness_m: tuple[float, float] = (0.05, 0.4)
    hysteresis_m: float = Field(0.3, ge=0.0, le=2.0)
    doorway_m: float = Field(0.3, ge=0.0, le=2.0)


class GridConfig(Settings):
    """The semantic grid."""

    resolution_m: float = Field(0.1, ge=0.02, le=1.0)
    key_scan_m: float = Field(0.5, gt=0.0, le=10.0)
    paint_range_m: float = Field(8.0, gt=0.0, le=100.0)


class SlamConfig(Settings):
    """The whole estimator; the defaults are ours, `SlamConfig.paper()` is the letter of the paper."""

    sensor: SensorModel = SensorModel()
    clustering: ClusteringConfig = ClusteringConfig()
    segments: SegmentConfig = SegmentConfig()
    corners: CornerConfig = CornerConfig()
    polygon: PolygonConfig = PolygonConfig()
    tracks: TrackConfig = TrackConfig()
    association: AssociationConfig = AssociationConfig()
    filter: FilterConfig = FilterConfig()
    rooms: RoomConfig = RoomConfig()
    grid: GridConfig = GridConfig()
