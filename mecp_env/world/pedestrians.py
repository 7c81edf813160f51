"""Compiled functions of the pedestrians: the velocity of each for a step, and the substeps in which it moves.

Where pedestrians can walk in a building, and the shortest paths there.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mecp_env.core import grid_paths
from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.jit import compiled

MARGIN_M = 0.05  # error of the raster
COMFORT_M, WALL_COST = 0.7, 3.0  # closer to walls than this a path costs more, up to this factor
SHORTCUT_M = 0.5  # distance of shortcuts from walls
NEAR_M = 1.0  # a pedestrian too close to a wall starts at a free cell within this distance


class WalkwayPlanner:
    """Paths of round pedestrians over the raster of a building's free space; derived, not part of a snapshot."""

    def __init__(self, free: Bools, corner: Array, cell_m: float, radius_m: float) -> None:
        label = np.where(free, grid_paths.FREE, grid_paths.OCCUPIED).astype(np.uint8)
        least = (radius_m + MARGIN_M) / cell_m + 0.5
        comfort = max(COMFORT_M / cell_m, least)
        self._corner, self._cell_m = corner, cell_m
        self.clearance = grid_paths.clearance(label, comfort)  # (H,W) cells to the nearest wall, up to the comfort
        self._cost = grid_paths.cell_costs(label, self.clearance, least, comfort, WALL_COST)
        self._open = np.where(self._cost > 0, 0, grid_paths.FAR).astype(np.int32)  # (H,W) FAR: barred
        self._shortcut = max(SHORTCUT_M / cell_m, least)
        self._fields: dict[tuple[int, int], tuple[NDArray[np.int32], NDArray[np.uint8]]] = {}

    def forget(self) -> None:
        """Forget the paths to all destinations: those of another episode are others, and each takes 0.2 MB and more."""
        self._fields.clear()

    def reachable(self, p_world: Array) -> Array:
        """(n,2) m: the centres of all cells reachable from `p_world` (2,); empty where no pedestrian can be."""
        start = self._nearest(self._open, p_world)
        if start is None:
            return np.empty((0, 2))
        rows, columns = np.nonzero(self._field(*start)[0] < grid_paths.FAR)
        middles: Array = self._corner + (np.stack([columns, rows], axis=1) + 0.5) * self._cell_m
        return middles

    def clearance_m(self, p_world: Array) -> Array:
        """(n,) m from each point (n,2) of the raster to the nearest wall, about, up to the comfortable distance."""
        columns, rows = np.floor((p_world - self._corner) / self._cell_m).astype(np.int64).T
        clear: Array = self.clearance[rows, columns] * self._cell_m
        return clear

    def route(self, p_from: Array, p_to: Array) -> Array:
        """Points (n,2) m of the shortest path between two points (2,), without the first; empty without a path."""
        end = self._nearest(self._open, p_to)
        if end is None:
            return np.empty((0, 2))
        total, step = self._field(*end)
        begin = self._nearest(total, p_from)
        if begin is None:
            return np.empty((0, 2))
        cells = grid_paths.smooth_path(step, *begin, self.clearance, self._cost, self._shortcut)
        points: Array = self._corner + cells[::-1] * self._cell_m
        return points

    def _field(self, row: int, column: int) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
        """Cost and step of the paths from a cell to all others."""
        if (row, column) not in self._fields:
            self._fields[row, column] = grid_paths.cost_to_go(self._cost, row, column)
        return self._fields[row, column]

    def _nearest(self, total: NDArray[np.int32], p_world: Array) -> tuple[int, int] | None:
        """Row and column of the nearest cell within `NEAR_M` that is not FAR."""
        x, y = ((p_world - self._corner) / self._cell_m).tolist()
        row, column = grid_paths.nearest_reached(total, x, y, NEAR_M / self._cell_m)
        return None if row < 0 else (row, column)


# A pedestrian (11,): position; velocity of this step; radius; preferred speed; remaining waiting time, time without
# progress, s; position at the start of the step; 1 in a substep in which it moves, else 0
X, Y, VX, VY, RADIUS, PACE, PAUSE, STUCK, FROM_X, FROM_Y, MOVES = range(11)
PEDESTRIAN = 11
WALKS, ARRIVED, IS_STUCK = 0, 1, 2  # state of a pedestrian
# The robot (6,): place, velocity, radius, deceleration

POLITE_M = 0.3  # distance that a polite pedestrian keeps from the robot and its stopping point
PRESS_M = 0.04  # others walk on until they overlap the robot by this
THERE_M = 0.15  # a place is reached
ROUNDING_M = 1e-9
SEE_M = 0.01  # clearance beside a path
SOONEST_S = 0.5  # smallest time to collision
HORIZON_S, BERTH_M = 2.0, 0.3  # horizon for avoiding others, and distance to keep
PATIENCE_S = 3.0  # time without progress before a new destination
SLOW = 0.3  # less than this share of the preferred speed is no progress
TURNS = np.radians(np.array([0.0, -25.0, 25.0, -50.0, 50.0, -80.0, 80.0, -120.0, 120.0, 180.0]))  # prefer the right
SHARES = np.array([1.0, 0.5])


@compiled
def steer(
    pedestrians: Array,
    routes: Array,
    legs: Ints,
    segments: Array,
    boxes: Array,
    robot: Array,
    polite: bool,
    step: float,
) -> Ints:
    """Choose a velocity for each of the pedestrians (n,11) for a step; returns the status of each (n,).

    `routes` (n,L,2) m and `legs` (n,2), the next point and how many there are; `boxes` (b,3): place and reach of each.
    No velocity chosen leads into one of the faces (S,2,2).
    """
    status = np.full(pedestrians.shape[0], WALKS)
    for i in range(pedestrians.shape[0]):
        walker, route, leg = pedestrians[i], routes[i], legs[i]
        moved = math.hypot(walker[X] - walker[FROM_X], walker[Y] - walker[FROM_Y])
        progress = walker[PAUSE] > 0.0 or moved > SLOW * walker[PACE] * step
        walker[STUCK] = 0.0 if progress else walker[STUCK] + step
        walker[FROM_X], walker[FROM_Y] = walker[X], walker[Y]
        if walker[PAUSE] > 0.0:
            walker[PAUSE] -= step
        elif walker[STUCK] > PATIENCE_S:
            status[i] = IS_STUCK
        else:
            x, y, wide, onward = walker[X], walker[Y], walker[RADIUS] + SEE_M, leg[0] + 1
            while onward < leg[1] and clear_leg(segments, x, y, route[onward, 0], route[onward, 1], wide):
                onward += 1
            leg[0] = onward - 1  # aim at the farthest next point in free sight
            near = math.hypot(route[leg[0], 0] - x, route[leg[0], 1] - y) <= THERE_M
            status[i] = ARRIVED if leg[0] + 1 >= leg[1] and (near or leg[1] == 0) else WALKS
        want_x, want_y = 0.0, 0.0
        if status[i] == WALKS and walker[PAUSE] <= 0.0 and leg[1] > 0:
            dx, dy = route[leg[0], 0] - walker[X], route[leg[0], 1] - walker[Y]
            share = min(walker[PACE] / max(math.hypot(dx, dy), 1e-9), 1.0 / step)
            want_x, want_y = dx * share, dy * share
        careful = polite or walker[STUCK] > 0.0
        choose(pedestrians, i, (want_x, want_y), segments, boxes, robot, (careful, polite), step)
    return status


@compiled
def choose(
    pedestrians: Array,
    i: int,
    want: tuple[float, float],
    segments: Array,
    boxes: Array,
    robot: Array,
    avoids: tuple[bool, bool],
    step: float,
) -> None:
    """Write the cheapest velocity of pedestrian i: near the wanted walker, clear of walls, at a distance from others.

    `avoids`: whether it avoids pedestrians and boxes, and whether it avoids the robot.
    """
    walker = pedestrians[i]
    best_x, best_y = 0.0, 0.0
    best = math.hypot(want[0], want[1]) / walker[PACE] + crowding(pedestrians, i, (0.0, 0.0), boxes, robot, avoids)
    heading, pace = math.atan2(want[1], want[0]), math.hypot(want[0], want[1])
    idle = pace == 0.0
    if idle and best == 0.0:
        walker[VX], walker[VY] = 0.0, 0.0
        return
    pace = walker[PACE] if idle else pace
    for turn in TURNS:
        for share in SHARES:
            vx, vy = share * pace * math.cos(heading + turn), share * pace * math.sin(heading + turn)
            cost = math.hypot(vx - want[0], vy - want[1]) / walker[PACE]
            if cost >= best:
                continue
            cost += crowding(pedestrians, i, (vx, vy), boxes, robot, avoids)
            to_x, to_y = walker[X] + vx * step, walker[Y] + vy * step
            if cost < best and clear_leg(segments, walker[X], walker[Y], to_x, to_y, walker[RADIUS]):
                best, best_x, best_y = cost, vx, vy
    walker[VX], walker[VY] = best_x, best_y


@compiled
def crowding(
    pedestrians: Array, i: int, velocity: tuple[float, float], boxes: Array, robot: Array, avoids: tuple[bool, bool]
) -> float:
    """Cost of a velocity of pedestrian i for coming close to others within the horizon.

    Each of them costs about 3 for a hit now, and nothing where it stays `BERTH_M` away; the robot costs twice as much.
    """
    cost, walker, n = 0.0, pedestrians[i], pedestrians.shape[0]
    last = n + boxes.shape[0]
    for j in range(0 if avoids[0] else last, last + 1 if avoids[1] else last):
        weight, berth, vx, vy = 1.0, BERTH_M, velocity[0], velocity[1]
        if j < n:
            x, y, radius = pedestrians[j, X], pedestrians[j, Y], pedestrians[j, RADIUS]
            vx, vy = vx - pedestrians[j, VX], vy - pedestrians[j, VY]
        elif j < last:
            x, y, radius, berth = boxes[j - n, 0], boxes[j - n, 1], boxes[j - n, 2], 0.5 * BERTH_M
        else:
            x, y, radius, weight = robot[0], robot[1], robot[4], 2.0
            vx, vy = vx - robot[2], vy - robot[3]
        apart = walker[RADIUS] + radius + (POLITE_M if j == last else 0.0)
        dx, dy, speed2 = x - walker[X], y - walker[Y], vx * vx + vy * vy
        time = (dx * vx + dy * vy) / speed2 if speed2 > 1e-12 else 0.0
        time = min(max(time, SOONEST_S), HORIZON_S)
        gap = math.hypot(dx - time * vx, dy - time * vy) - apart
        if j != i and gap < berth:
            near = (3.0 if gap < 0.0 else 1.0 - gap / berth) * (1.0 - 0.8 * time / HORIZON_S) + max(-gap, 0.0)
            cost += weight * near
    return cost


@compiled
def from_face(segments: Array, k: int, x: float, y: float) -> tuple[float, float]:
    """Vector to (x, y) from the nearest point of face k."""
    ax, ay = segments[k, 0, 0], segments[k, 0, 1]
    ux, uy = segments[k, 1, 0] - ax, segments[k, 1, 1] - ay
    share = min(max(((x - ax) * ux + (y - ay) * uy) / (ux * ux + uy * uy), 0.0), 1.0)
    return x - ax - share * ux, y - ay - share * uy


@compiled
def clear_leg(segments: Array, x0: float, y0: float, x1: float, y1: float, radius: float) -> bool:
    """True when a disc that goes straight from (x0, y0) to (x1, y1) touches none of the faces (S,2,2).

    A disc that starts nearer to a face than its radius may go where it comes no nearer.
    """
    dx, dy = x1 - x0, y1 - y0
    length2 = dx * dx + dy * dy
    reach = radius + math.sqrt(length2)
    for k in range(segments.shape[0]):
        ax, ay, bx, by = segments[k, 0, 0], segments[k, 0, 1], segments[k, 1, 0], segments[k, 1, 1]
        if max(min(ax, bx) - x0, x0 - max(ax, bx), min(ay, by) - y0, y0 - max(ay, by)) >= reach:
            continue  # most of them, without a division
        to_x, to_y = from_face(segments, k, x0, y0)
        square = to_x * to_x + to_y * to_y
        if square >= reach * reach:
            continue
        least = min(radius, math.sqrt(square)) - ROUNDING_M
        to_x, to_y = from_face(segments, k, x1, y1)
        if math.hypot(to_x, to_y) < least:
            return False
        before, after = (bx - ax) * (y0 - ay) - (by - ay) * (x0 - ax), (bx - ax) * (y1 - ay) - (by - ay) * (x1 - ax)
        left, right = dx * (ay - y0) - dy * (ax - x0), dx * (by - y0) - dy * (bx - x0)
        if before * after < 0.0 and left * right < 0.0:
            return False
        for end in range(2):
            px, py = segments[k, end, 0] - x0, segments[k, end, 1] - y0
            share = min(max((px * dx + py * dy) / max(length2, 1e-12), 0.0), 1.0)
            if math.hypot(px - share * dx, py - share * dy) < least:
                return False
    return True


@compiled
def walk(pedestrians: Array, boxes: Array, robot: Array, polite: bool, dt: float) -> None:
    """One substep of all pedestrians; one that would come too close to another, a box, or the robot, waits.

    Too close is an overlap that the substep makes deeper. A waiting pedestrian keeps its velocity and tries again in
    the next substep. A polite one avoids the robot's position, half of its braking distance, and where it can stop.
    """
    n, b = pedestrians.shape[0], boxes.shape[0]
    braking_s = math.hypot(robot[2], robot[3]) / robot[5]
    for i in range(n):
        walker = pedestrians[i]
        moves = walker[VX] != 0.0 or walker[VY] != 0.0
        for j in range(n + b + (3 if polite else 1) if moves else 0):
            if j < n:
                x, y, apart = pedestrians[j, X], pedestrians[j, Y], walker[RADIUS] + pedestrians[j, RADIUS]
            elif j < n + b:
                x, y, apart = boxes[j - n, 0], boxes[j - n, 1], walker[RADIUS] + boxes[j - n, 2]
            else:
                share = 0.5 * (j - n - b)
                x, y = robot[0] + share * braking_s * robot[2], robot[1] + share * braking_s * robot[3]
                apart = walker[RADIUS] + robot[4] + (POLITE_M if polite else -PRESS_M)
            dx, dy = walker[X] - x, walker[Y] - y
            after = math.hypot(dx + walker[VX] * dt, dy + walker[VY] * dt)
            if j != i and after < apart and after < math.hypot(dx, dy):
                moves = False
                break
        walker[MOVES] = 1.0 if moves else 0.0
        if moves:
            walker[X] += walker[VX] * dt
            walker[Y] += walker[VY] * dt
