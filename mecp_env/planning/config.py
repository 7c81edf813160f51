"""Configuration of planning: one frozen section, lengths in metres, times in control steps."""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from mecp_env.core.carriers import Array
from mecp_env.core.settings import Settings


class GoalsConfig(Settings):
    """Goals: places with something left to see."""

    open_beyond_m: float = Field(0.4, gt=0.0, le=2.0)  # distance of the goal beyond the middle of an open interval
    open_width_m: float = Field(0.5, gt=0.0, le=5.0)  # narrower open intervals are not goals
    uncovered_m: float = Field(0.6, gt=0.0, le=5.0)  # width of floor outside polygons that is a goal
    uncovered_cells: int = Field(10, ge=1, le=1000)  # cells of it, without the rim
    further_m: float = Field(1.0, gt=0.0, le=5.0)  # distance into a room without a polygon, from where it was entered
    candidate_m: float = Field(1.5, gt=0.0, le=5.0)  # viewing distance of a door candidate
    door_beyond_m: float = Field(0.9, gt=0.0, le=3.0)  # distance of the goal beyond the middle of a door
    frontier_cells: int = Field(5, ge=1, le=1000)  # smaller frontiers are not goals
    wall_behind_m: float = Field(0.5, gt=0.0, le=5.0)  # a gap with a wall this close behind it is a corner
    same_gap_m: float = Field(0.8, gt=0.0, le=5.0)  # a gap this close to a door is that door, seen at a grazing angle
    door_clear_m: float = Field(0.5, ge=0.0, le=3.0)  # frontier cells this close to a door belong to the door
    reach_m: float = Field(0.8, gt=0.0, le=3.0)  # a goal is reachable when the robot can come this close
    seen_m: float = Field(1.0, ge=0.0, le=10.0)  # what was looked at from so near in a room is no goal once it is left
    apart_m: float = Field(0.5, gt=0.0, le=5.0)  # goals of one kind closer than this are one goal
    refusals: int = Field(3, ge=1, le=100)  # a goal refused this often is given up
    retries: int = Field(2, ge=0, le=100)  # number of retries of refused goals with pedestrians
    visits: int = Field(2, ge=1, le=100)  # a goal still open after so many is given up; an open edge: one
    settled: int = Field(6, ge=1, le=100)  # given up after closing from a distance and reopening this often


class PathsConfig(Settings):
    """The grid planner."""

    radius_m: float = Field(0.22, gt=0.0, le=2.0)  # of the robot
    margin_m: float = Field(0.05, ge=0.0, le=1.0)
    comfort_m: float = Field(0.6, gt=0.0, le=3.0)  # a path costs more closer to walls than this
    wall_cost: float = Field(6.0, ge=0.0, le=20.0)  # cost factor at the smallest distance
    shortcut_m: float = Field(0.45, ge=0.0, le=3.0)  # distance of shortcuts from walls


class ControlConfig(Settings):
    """The controller; limits as in the robot's own configuration."""

    speed_m_s: float = Field(0.75, gt=0.0, le=5.0)
    turn_rad_s: float = Field(1.75, gt=0.0, le=10.0)
    acceleration_m_s2: float = Field(1.0, gt=0.0, le=100.0)
    period_s: float = Field(0.4, gt=0.0, le=5.0)
    lookahead_m: float = Field(0.6, gt=0.05, le=5.0)
    turn_first_deg: float = Field(50.0, gt=0.0, le=180.0)  # a larger heading error is corrected by turning in place
    guard_m: float = Field(0.06, ge=0.0, le=1.0)  # distance to keep from laser hits
    near_m: float = Field(2.0, gt=0.0, le=100.0)  # hits farther away do not slow the robot
    arc_step_m: float = Field(0.05, gt=0.0, le=1.0)  # between two checks along an arc


class NavigatorConfig(Settings):
    """One drive to one goal."""

    reached_m: float = Field(0.25, gt=0.0, le=2.0)
    dwell_steps: int = Field(3, ge=0, le=100)  # observation time before a goal counts as reached
    limit_steps: int = Field(250, ge=1, le=10_000)  # beyond those that the way takes at full speed
    replan_steps: int = Field(10, ge=1, le=1000)
    off_path_m: float = Field(0.4, gt=0.0, le=5.0)  # the robot plans again when it is farther from its path
    tries: int = Field(3, ge=1, le=100)  # plans without a path before the goal is refused
    approach_m: float = Field(0.6, ge=0.0, le=5.0)  # a door is entered along its normal from this distance
    back_m_s: float = Field(0.2, gt=0.0, le=5.0)  # speed of backing off
    back_steps: int = Field(4, ge=1, le=100)  # of backing off
    stuck_steps: int = Field(10, ge=2, le=1000)  # without progress for this time the robot backs off
    progress_m: float = Field(0.15, gt=0.0, le=2.0)
    recoveries: int = Field(3, ge=0, le=100)  # after this many the goal is refused


class KnownGroundConfig(Settings):
    """Goals on known ground: places from which the robot may recognise what it has mapped, and waiting."""

    places: int = Field(0, ge=0, le=8)  # at most; 0: none
    wait_steps: int = Field(0, ge=0, le=100)  # of the goal that waits; 0: there is none
    apart_m: float = Field(2.0, gt=0.0, le=50.0)  # between two places
    around_m: float = Field(15.0, gt=0.0, le=1000.0)  # a place is not farther away, in a straight line
    loop_m: float = Field(10.0, gt=0.0, le=1000.0)  # driven since a place was left: to come back closes a loop
    good_sigma_m: float = Field(0.05, gt=0.0, le=10.0)  # of the position, at a good place

    @property
    def is_offered(self) -> bool:
        """True when there are any such goals."""
        return self.places > 0 or self.wait_steps > 0


class PredictionConfig(Settings):
    """The virtual filter that predicts the uncertainty on arrival; sensors as in the robot's own configuration."""

    distance_sigma_m: float = Field(0.1, ge=0.0, le=10.0)  # of odometry, per square root of a metre
    turn_sigma_deg: float = Field(1.5, ge=0.0, le=300.0)  # the same, of the heading
    turn_m: float = Field(0.5, ge=0.0, le=10.0)  # path equivalent of a turn of 90 deg
    max_range_m: float = Field(30.0, gt=0.0, le=1000.0)  # of the laser
    field_of_view_deg: float = Field(360.0, gt=0.0, le=360.0)
    corner_sigma_m: float = Field(0.03, gt=0.0, le=1.0)  # of a landmark's place as it is measured
    step_m: float = Field(0.8, gt=0.0, le=10.0)  # between two looks along a path

    @property
    def numbers(self) -> Array:
        """(7,) the numbers in SI units, as the compiled functions take them."""
        turn_rad, view_rad = math.radians(self.turn_sigma_deg), math.radians(self.field_of_view_deg)
        noise = self.distance_sigma_m, turn_rad, self.turn_m
        return np.array([*noise, self.max_range_m, view_rad, self.corner_sigma_m, self.step_m])


class PlanningConfig(Settings):
    """Goals, paths, control and drives."""

    goals: GoalsConfig = GoalsConfig()
    paths: PathsConfig = PathsConfig()
    control: ControlConfig = ControlConfig()
    navigator: NavigatorConfig = NavigatorConfig()
    known_ground: KnownGroundConfig = KnownGroundConfig()
    prediction: PredictionConfig = PredictionConfig()
