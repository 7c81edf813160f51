"""Configuration of planning: one frozen section, lengths in metres, times in control steps."""

from __future__ import annotations

from pydantic import Field

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
    apart_m: float = Field(0.5, gt=0.0, le=5.0)  # goals of one kind closer than this are one goal
    refusals: int = Field(3, ge=1, le=100)  # a goal refused this often is given up
    retries: int = Field(2, ge=0, le=100)  # number of retries of refused goals with pedestrians
    visits: int = Field(2, ge=1, le=100)  # a goal still open after this many visits is given up
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
    limit_steps: int = Field(250, ge=1, le=10_000)
    replan_steps: int = Field(10, ge=1, le=1000)
    off_path_m: float = Field(0.4, gt=0.0, le=5.0)  # the robot plans again when it is farther from its path
    tries: int = Field(3, ge=1, le=100)  # plans without a path before the goal is refused
    approach_m: float = Field(0.6, ge=0.0, le=5.0)  # a door is entered along its normal from this distance
    back_m_s: float = Field(0.2, gt=0.0, le=5.0)  # speed of backing off
    back_steps: int = Field(4, ge=1, le=100)  # of backing off
    stuck_steps: int = Field(10, ge=2, le=1000)  # without progress for this time the robot backs off
    progress_m: float = Field(0.15, gt=0.0, le=2.0)
    recoveries: int = Field(3, ge=0, le=100)  # after this many the goal is refused


class PlanningConfig(Settings):
    """Goals, paths, control and drives."""

    goals: GoalsConfig = GoalsConfig()
    paths: PathsConfig = PathsConfig()
    control: ControlConfig = ControlConfig()
    navigator: NavigatorConfig = NavigatorConfig()
