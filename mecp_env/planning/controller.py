"""From a path to a command (v, w): pure pursuit, turning first towards a path behind, slower near what is seen."""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.carriers import Array, Bools, Rows
from mecp_env.core.jit import compiled
from mecp_env.core.se2 import to_map
from mecp_env.planning.config import ControlConfig, PathsConfig
from mecp_env.slam.messages import MergedScan

SHARES = (1.0, 0.75, 0.5, 0.3, 0.15)  # shares of the desired speed, fastest first
CENTRED = np.zeros(3)  # T_robot_laser of a laser at the robot's centre
BENDS = (0.0, 0.6, -0.6, 1.5, -1.5)  # 1/m, added to the desired curvature where the path is blocked


def follow(
    path: Array,
    T_map_robot: Array,
    beams: MergedScan,
    control: ControlConfig,
    body: PathsConfig,
    T_robot_laser: Array = CENTRED,
) -> tuple[float, float]:
    """Speed (m/s) and turn rate (rad/s) of the next step along a path (n,2) m, map frame.

    (0, w) turns in place; (0, 0) means that every arc is blocked.
    """
    scan = beams.ranges, beams.bearings, beams.hit, T_robot_laser
    v, w = follow_path(path, T_map_robot, scan, control.record, body.record)
    return v, w


def coast(
    command: tuple[float, float],
    before: tuple[float, float],
    beams: MergedScan,
    control: ControlConfig,
    body: PathsConfig,
    T_robot_laser: Array = CENTRED,
) -> tuple[float, float]:
    """The command, or, where the way to a stop would bend into something seen, braking on the arc driven before.

    A robot commanded to turn in place rolls on while it brakes.
    """
    v, w = before
    if command[0] > 0.0 or v <= 0.05:
        return command
    safe = can_stop(seen_points(beams, control, T_robot_laser), v, command[1] / v, 0.0, control.record, body.record)
    return command if safe else (0.0, 0.5 * w)


@compiled
def follow_path(
    path: Array,
    T_map_robot: Array,
    scan: tuple[Array, Array, Bools, Array],
    control_record: Rows,
    body_record: Rows,
) -> tuple[float, float]:
    """See `follow`; `scan`: ranges (m), bearings and hit (B,), and the pose of the laser (3,)."""
    control, top_turn = control_record[0], control_record[0].turn_rad_s
    x, y, left = look_ahead(path, T_map_robot, control.lookahead_m)
    bearing = math.atan2(y, x)
    if abs(bearing) > control.turn_first_rad:
        return 0.0, min(max(bearing / control.period_s, -top_turn), top_turn)
    speed = min(control.speed_m_s, math.sqrt(control.acceleration_m_s2 * left), max(left, 0.05) / control.period_s)
    curvature = 2.0 * y / max(x * x + y * y, 0.01)
    speed = min(speed * math.cos(bearing), 0.8 * top_turn / max(abs(curvature), 1e-6))
    p_robot = near_points(scan[0], scan[1], scan[2], control.near_m, scan[3])
    return safe_command(speed, curvature, p_robot, control_record, body_record)


@compiled
def safe_command(
    speed: float, curvature: float, p_robot: Array, control_record: Rows, body_record: Rows
) -> tuple[float, float]:
    """The fastest command near the desired one that can stop before the points (n,2) m; (0, 0) without one."""
    control = control_record[0]
    for i in range(len(SHARES)):
        v = SHARES[i] * speed
        for k in range(len(BENDS)):
            bent = curvature + BENDS[k]
            turns = abs(v * bent) <= control.turn_rad_s
            if turns and can_stop(p_robot, v, bent, control.period_s, control_record, body_record):
                return v, v * bent
    return 0.0, 0.0


def seen_points(beams: MergedScan, control: ControlConfig, T_robot_laser: Array = CENTRED) -> Array:
    """Hits (n,2) m, robot frame, within `near_m`; each the median of five neighbouring beams, against noise."""
    return near_points(beams.ranges, beams.bearings, beams.hit, control.near_m, T_robot_laser)


@compiled
def near_points(ranges: Array, bearings: Array, hit: Bools, reach: float, T_robot_laser: Array) -> Array:
    """Hits (n,2) m, robot frame, nearer to the laser than `reach`, each range the median of five neighbours."""
    count, n = ranges.shape[0], 0
    points, ring = np.empty((count, 2)), np.empty(count + 4)  # twice the first two and the last two
    for i in range(count + 4):
        ring[i] = ranges[(i - 2) % count]
    for i in range(count):
        if not hit[i] or ranges[i] > reach:
            continue
        a, b, c, d, e = ring[i], ring[i + 1], ring[i + 2], ring[i + 3], ring[i + 4]
        low, high = max(min(a, b), min(c, d)), min(max(a, b), max(c, d))  # the median is one of these two, or e
        middle = max(min(low, high), min(max(low, high), e))
        points[n, 0] = middle * math.cos(bearings[i])
        points[n, 1] = middle * math.sin(bearings[i])
        n += 1
    return to_map(T_robot_laser, points[:n])


@compiled
def nearest_point(p_robot: Array, x: float, y: float) -> float:
    """Distance (m) from (x, y) to the nearest of the points (n,2)."""
    best = math.inf
    for i in range(p_robot.shape[0]):
        dx, dy = p_robot[i, 0] - x, p_robot[i, 1] - y
        best = min(best, dx * dx + dy * dy)
    return math.sqrt(best)


@compiled
def can_stop(
    p_robot: Array, v: float, curvature: float, delay_s: float, control_record: Rows, body_record: Rows
) -> bool:
    """True when the robot can brake, after a delay on its arc, without coming too near to the points (n,2) m.

    That is radius + guard, or the present distance where it is less: then the arc must lead no nearer.
    """
    keep_off = body_record[0].radius_m + control_record[0].guard_m
    length = abs(v) * delay_s + v * v / (2.0 * control_record[0].acceleration_m_s2)
    least = min(keep_off, nearest_point(p_robot, 0.0, 0.0) - 1e-3)
    steps = int(length / control_record[0].arc_step_m) + 1
    for i in range(1, steps + 1):
        s = math.copysign(length * i / steps, v)
        turn = s * curvature
        if abs(turn) < 1e-6:
            x, y = s, 0.5 * s * turn
        else:
            x, y = math.sin(turn) / curvature, (1.0 - math.cos(turn)) / curvature
        if nearest_point(p_robot, x, y) < least:
            return False
    return True


@compiled
def look_ahead(path: Array, T_map_robot: Array, ahead: float) -> tuple[float, float, float]:
    """Point (robot frame) of the path (n,2) `ahead` (m) of its place nearest to the robot, and the path left there."""
    best, best_leg, best_share = math.inf, 0, 0.0
    for i in range(path.shape[0] - 1):
        dx, dy = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        square = max(dx * dx + dy * dy, 1e-12)
        share = ((T_map_robot[0] - path[i, 0]) * dx + (T_map_robot[1] - path[i, 1]) * dy) / square
        share = min(max(share, 0.0), 1.0)
        off = math.hypot(path[i, 0] + share * dx - T_map_robot[0], path[i, 1] + share * dy - T_map_robot[1])
        if off < best:
            best, best_leg, best_share = off, i, share
    left, x, y, found = 0.0, path[-1, 0], path[-1, 1], False
    for i in range(best_leg, path.shape[0] - 1):
        dx, dy = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        length = math.hypot(dx, dy)
        first = best_share * length if i == best_leg else 0.0
        if not found and left + length - first >= ahead:
            share = (first + ahead - left) / max(length, 1e-9)
            x, y, found = path[i, 0] + share * dx, path[i, 1] + share * dy, True
        left += length - first
    if path.shape[0] == 1:
        left = math.hypot(x - T_map_robot[0], y - T_map_robot[1])
    c, s = math.cos(T_map_robot[2]), math.sin(T_map_robot[2])
    dx, dy = x - T_map_robot[0], y - T_map_robot[1]
    return c * dx + s * dy, -s * dx + c * dy, left


@compiled
def off_path(path: Array, x: float, y: float) -> float:
    """Distance (m) from (x, y) to the nearest place of a path (n,2)."""
    best = math.hypot(path[0, 0] - x, path[0, 1] - y)
    for i in range(path.shape[0] - 1):
        dx, dy = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        share = ((x - path[i, 0]) * dx + (y - path[i, 1]) * dy) / max(dx * dx + dy * dy, 1e-12)
        share = min(max(share, 0.0), 1.0)
        best = min(best, math.hypot(path[i, 0] + share * dx - x, path[i, 1] + share * dy - y))
    return best
