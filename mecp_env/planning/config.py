"""Configuration of planning: one frozen section, lengths in metres, times in control steps."""

from __future__ import annotations

from pydantic import Field

from mecp_env.core.settings import Settings


class GoalsConfig(Settings):
    """Where there is something left to see."""

    open_beyond_m: float = Field(0.4, gt=0.0, le=2.0)  # the goal lies so far beyond the middle of an open interval
    open_width_m: float = Field(0.5, gt=0.0, le=5.0)  # narrower open intervals are no goals
    uncovered_m: float = Field(0.6, gt=0.0, le=5.0)  # width of floor outside polygons that is a goal
    uncovered_cells: int = Field(10, ge=1, le=1000)  # cells of it, without the rim
    further_m: float = Field(1.0, gt=0.0, le=5.0)  # into a room without a polygon, from where it was entered
    candidate_m: float = Field(1.5, gt=0.0, le=5.0)  # a door candidate is looked at from so far
    door_beyond_m: float = Field(0.9, gt=0.0, le=3.0)  # the goal lies so far beyond the middle of a door
    frontier_cells: int = Field(5, ge=1, le=1000)  # smaller frontiers are no goals
    door_clear_m: float = Field(0.5, ge=0.0, le=3.0)  # frontier cells as near to a door belong to the door
    reach_m: float = Field(0.8, gt=0.0, le=3.0)  # a goal counts as reachable when the robot can come so near
    apart_m: float = Field(0.5, gt=0.0, le=5.0)  # goals of one kind as near are one
    refusals: int = Field(3, ge=1, le=100)  # a goal refused so often is given up
    retries: int = Field(2, ge=0, le=100)  # how often refused goals are tried again where people walk
    visits: int = Field(2, ge=1, le=100)  # a goal that reaching does not settle is given up after so many visits
    settled: int = Field(6, ge=1, le=100)  # and one that is settled from afar, and a goal again, so often


class PathsConfig(Settings):
    """The grid planner."""

    radius_m: float = Field(0.22, gt=0.0, le=2.0)  # of the robot
    margin_m: float = Field(0.05, ge=0.0, le=1.0)
    comfort_m: float = Field(0.6, gt=0.0, le=3.0)  # nearer to walls a path costs more
    wall_cost: float = Field(6.0, ge=0.0, le=20.0)  # times as much as in the open, at the least distance
    shortcut_m: float = Field(0.45, ge=0.0, le=3.0)  # shortcuts keep so far from walls


class ControlConfig(Settings):
    """The controller; limits as in the robot's own configuration."""

    speed_m_s: float = Field(0.75, gt=0.0, le=5.0)
    turn_rad_s: float = Field(1.75, gt=0.0, le=10.0)
    acceleration_m_s2: float = Field(1.0, gt=0.0, le=100.0)
    period_s: float = Field(0.4, gt=0.0, le=5.0)
    lookahead_m: float = Field(0.6, gt=0.05, le=5.0)
    turn_first_deg: float = Field(50.0, gt=0.0, le=180.0)  # a larger heading error is turned out on the spot
    guard_m: float = Field(0.06, ge=0.0, le=1.0)  # the laser keeps the robot so far from what it sees


class NavigatorConfig(Settings):
    """One drive to one goal."""

    reached_m: float = Field(0.25, gt=0.0, le=2.0)
    dwell_steps: int = Field(3, ge=0, le=100)  # the robot looks so long before it calls a goal reached
    limit_steps: int = Field(250, ge=1, le=10_000)
    replan_steps: int = Field(10, ge=1, le=1000)
    stuck_steps: int = Field(10, ge=2, le=1000)  # without progress for so long the robot backs off
    progress_m: float = Field(0.15, gt=0.0, le=2.0)
    recoveries: int = Field(3, ge=0, le=100)  # after so many the goal is refused


class PlanningConfig(Settings):
    """Goals, paths, control and drives."""

    goals: GoalsConfig = GoalsConfig()
    paths: PathsConfig = PathsConfig()
    control: ControlConfig = ControlConfig()
    navigator: NavigatorConfig = NavigatorConfig()
