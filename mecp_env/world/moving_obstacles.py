"""Dynamic obstacles of an episode: pedestrians who walk from room to room, and boxes that the robot can push.

Everything is drawn at reset. Later decisions of the pedestrians use a separate random generator, so that their motion
depends on the state only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.world import pedestrians
from mecp_env.world.config import ClutterConfig, CrowdConfig, RobotConfig
from mecp_env.world.outline import Outline
from mecp_env.world.pedestrians import WalkwayPlanner

LEGS = 96  # stored points of a route; a pedestrian who reaches the last one before the destination plans again
PLACES_PER_ROOM = 3
OFF_DOORS_M = 1.0  # no destination is closer to a door
BOX_OFF_DOORS_M = 1.2
OFF_ROBOT_M = 1.2  # at the start, between the outlines
APART_M = 0.1
CHOICES = 6  # candidate destinations of a blocked pedestrian
STEP_M = 0.3  # along a route, to determine its direction
TRIES = 60
BOX = 6  # place, turn, and their velocities
SIDES = 16  # of the polygon that represents a pedestrian for the laser
ANGLES = [-k * (2.0 * math.pi / SIDES) for k in range(SIDES + 1)]
RIM = np.array([(math.cos(angle), math.sin(angle)) for angle in ANGLES])  # clockwise, the first point twice
BOX_CORNERS = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])  # of a unit box, counter-clockwise
DISC = np.array([pedestrians.X, pedestrians.Y, pedestrians.RADIUS])


@dataclass(slots=True, eq=False)
class Moving:
    """Pedestrians, boxes, closed doors and dark walls of the building; plain state."""

    pedestrians: Array = field(
        default_factory=lambda: np.empty((0, pedestrians.PEDESTRIAN))
    )  # (n,11), see pedestrians.py
    routes: Array = field(default_factory=lambda: np.empty((0, LEGS, 2)))  # (n,L,2) m, world
    legs: Ints = field(default_factory=lambda: np.empty((0, 2), np.int64))  # (n,2) next point, how many
    places: Array = field(default_factory=lambda: np.empty((0, 2)))  # (p,2) m, possible destinations
    rooms: Ints = field(default_factory=lambda: np.empty(0, np.int64))  # (p,) the room of each
    boxes: Array = field(default_factory=lambda: np.empty((0, BOX)))  # (b,6) x, y, turn, their velocities
    sizes: Array = field(default_factory=lambda: np.empty((0, 2)))  # (b,2) m
    closed: Ints = field(default_factory=lambda: np.empty(0, np.int64))  # doors of the layout
    start: Array = field(default_factory=lambda: np.zeros(2))  # (2,) m, the building is what can be reached from here
    dark_seed: int = 0  # of the walls that the laser sees badly
    random: np.random.Generator = field(default_factory=lambda: np.random.Generator(np.random.PCG64(0)))

    def can_continue(self) -> bool:
        """True when the next point of each route is one of its points, and the pedestrians have destinations."""
        within = self.legs[:, 0] <= np.maximum(self.legs[:, 1] - 1, 0)
        return bool(within.all()) and len(self.places) >= min(len(self.pedestrians), 1)


class Movers:
    """The dynamic obstacles of one building, step by step; everything that outlives a step is in `state`."""

    def __init__(self, walkways: WalkwayPlanner | None, config: CrowdConfig, robot: RobotConfig, state: Moving) -> None:
        self.config, self.robot, self.state = config, robot, state
        self._walkways = walkways

    def __len__(self) -> int:
        return len(self.state.pedestrians) + len(self.state.boxes)

    @property
    def faces(self) -> Array:
        """(m,2,2) m, world frame: their faces for the laser, free space on the left."""
        return moving_faces(self.pedestrian_discs, self.state.boxes, self.state.sizes)

    @property
    def box_corners(self) -> Array:
        """(4b,2) m: corners of the boxes, counter-clockwise."""
        return box_corners(self.state.boxes, self.state.sizes)

    @property
    def walking(self) -> Array:
        """(n,3) m: position and radius of the pedestrians, and of the boxes that slide."""
        if not len(self.state.boxes):
            return self.pedestrian_discs
        slides = self.state.boxes[:, 3:].any(axis=1)
        return np.concatenate([self.pedestrian_discs, self.box_discs[slides]])

    @property
    def pedestrian_discs(self) -> Array:
        """(n,3) m: position and radius of the pedestrians."""
        discs: Array = self.state.pedestrians.take(DISC, axis=1)
        return discs

    @property
    def box_discs(self) -> Array:
        """(b,3) m: position and radius of the boxes."""
        discs = np.empty((len(self.state.boxes), 3))
        if len(discs):
            discs[:, :2], discs[:, 2] = self.state.boxes[:, :2], 0.5 * np.hypot(*self.state.sizes.T)
        return discs

    def decide(self, segments: Array, T_world_robot: Array, velocity: Array) -> None:
        """All pedestrians choose a velocity for the next step, and a new destination when they have arrived."""
        state, config = self.state, self.config
        if not len(state.pedestrians):
            return
        robot = robot_row(T_world_robot, velocity, self.robot)
        boxes, step = self.box_discs, self.robot.period_s
        status = pedestrians.steer(
            state.pedestrians, state.routes, state.legs, segments, boxes, robot, config.polite, step
        )
        for i in np.flatnonzero(status).tolist():
            if status[i] == pedestrians.ARRIVED:
                state.pedestrians[i, pedestrians.PAUSE] = state.random.uniform(*config.pause_s)
                self._go_to_another_room(i)
            else:
                self._turn_away(i, robot[:2])

    def _go_to_another_room(self, i: int) -> None:
        state = self.state
        here = int(np.argmin(np.hypot(*(state.places - state.pedestrians[i, :2]).T)))
        elsewhere = np.flatnonzero(state.rooms != state.rooms[here])
        chosen = state.random.choice(elsewhere) if len(elsewhere) else state.random.integers(len(state.places))
        self._set_out(i, self._route(i, int(chosen)))

    def _turn_away(self, i: int, p_robot: Array) -> None:
        """Pedestrian i is blocked: it chooses another destination, on a path that starts away from the robot (2,)."""
        state = self.state
        state.pedestrians[i, pedestrians.STUCK] = 0.0
        for place in state.random.permutation(len(state.places))[:CHOICES].tolist():
            route = self._route(i, place)
            if leads_away(state.pedestrians[i, :2], route, p_robot):
                break
        self._set_out(i, route)

    def _route(self, i: int, place: int) -> Array:
        """(n,2) m: the shortest path of pedestrian i to a place."""
        assert self._walkways is not None
        return self._walkways.route(self.state.pedestrians[i, :2], self.state.places[place])[:LEGS]

    def _set_out(self, i: int, route: Array) -> None:
        """Pedestrian i follows a route (n,2)."""
        self.state.routes[i, : len(route)] = route
        self.state.legs[i] = 0, len(route)

    def populate(self, outline: Outline, clutter: ClutterConfig, rng: np.random.Generator) -> None:
        """Draw boxes and pedestrians around the start; one number is drawn from `rng`."""
        assert self._walkways is not None
        self._walkways.forget()
        self.state.random = np.random.Generator(np.random.PCG64(int(rng.integers(2**63))))
        cells = self._walkways.reachable(self.state.start)
        far = np.hypot(*(cells - self.state.start).T) > OFF_ROBOT_M + self.robot.radius_m + self.config.radius_m[1]
        cells = cells[far]
        off_doors = np.linalg.norm(cells[:, None] - outline.doors.centre, axis=2).min(axis=1, initial=math.inf)
        self._place_boxes(cells[off_doors > BOX_OFF_DOORS_M], clutter)
        self._choose_places(cells[off_doors > OFF_DOORS_M], outline)
        if len(self.state.places):
            self._place_pedestrians(cells)

    def _place_boxes(self, cells: Array, clutter: ClutterConfig) -> None:
        """Boxes on free floor away from doors, as many as configured if they fit."""
        assert self._walkways is not None
        state, clear = self.state, self._walkways.clearance_m(cells)
        for _ in range(clutter.movable_boxes):
            size = state.random.uniform(*clutter.box_m, 2)
            turn, reach = state.random.uniform(-math.pi, math.pi), 0.5 * math.hypot(*size)
            cell = self._draw_cell(cells[clear > reach + APART_M], reach)
            if cell is not None:
                state.boxes = np.vstack([state.boxes, [*cell, turn, 0.0, 0.0, 0.0]])
                state.sizes = np.vstack([state.sizes, size])

    def _choose_places(self, cells: Array, outline: Outline) -> None:
        """Some places in every room."""
        state, rooms = self.state, outline.room_at(cells)
        for room in np.unique(rooms[rooms >= 0]).tolist():
            mine = cells[rooms == room]
            chosen = state.random.integers(len(mine), size=PLACES_PER_ROOM)
            state.places = np.vstack([state.places, mine[chosen]])
            state.rooms = np.append(state.rooms, np.full(PLACES_PER_ROOM, room))

    def _place_pedestrians(self, cells: Array) -> None:
        """Pedestrians on the free floor with a destination, as many as configured if they fit."""
        state, config = self.state, self.config
        for i in range(config.people):
            radius, pace = state.random.uniform(*config.radius_m), state.random.uniform(*config.speed_m_s)
            cell = self._draw_cell(cells, radius)
            if cell is None:
                return
            walker = np.zeros(pedestrians.PEDESTRIAN)
            walker[[pedestrians.X, pedestrians.Y, pedestrians.RADIUS, pedestrians.PACE]] = *cell, radius, pace
            walker[[pedestrians.FROM_X, pedestrians.FROM_Y]] = cell
            state.pedestrians = np.vstack([state.pedestrians, walker])
            state.routes = np.concatenate([state.routes, np.zeros((1, LEGS, 2))])
            state.legs = np.vstack([state.legs, [0, 0]])
            self._go_to_another_room(i)

    def _draw_cell(self, cells: Array, reach: float) -> Array | None:
        """One of the places (n,2) at which an object of this radius touches nothing, or None."""
        discs = np.concatenate([self.pedestrian_discs, self.box_discs])
        for _ in range(TRIES if len(cells) else 0):
            cell: Array = cells[self.state.random.integers(len(cells))]
            if (np.hypot(*(discs[:, :2] - cell).T) > discs[:, 2] + reach + APART_M).all():
                return cell
        return None


def wants_movers(crowd: CrowdConfig, clutter: ClutterConfig) -> bool:
    """True when pedestrians or boxes are configured."""
    return crowd.people > 0 or clutter.movable_boxes > 0


def no_movers(robot: RobotConfig) -> Movers:
    """No dynamic obstacles."""
    return Movers(None, CrowdConfig(), robot, Moving())


def leads_away(p_world: Array, route: Array, p_robot: Array) -> bool:
    """True when the path from `p_world` (2,) along a route (n,2) starts away from the robot (2,)."""
    aside = np.hypot(*(route - p_world).T) > STEP_M
    return bool(aside.any()) and bool((route[int(np.argmax(aside))] - p_world) @ (p_robot - p_world) <= 0.0)


def robot_row(T_world_robot: Array, velocity: Array, robot: RobotConfig) -> Array:
    """The robot (6,) as the compiled functions of the pedestrians need it."""
    row = np.empty(6)
    row[:2], row[2:4], row[4:] = T_world_robot[:2], velocity[:2], (robot.radius_m, robot.max_acceleration_m_s2)
    return row


def moving_faces(discs: Array, boxes: Array, sizes: Array) -> Array:
    """Faces (m,2,2) of discs (n,3), as polygons of 16 sides, and of boxes (b,>=3) of sizes (b,2); free to the left.

    Discs: place, radius; boxes: place, turn.
    """
    rims = discs[:, None, :2] + discs[:, 2:, None] * RIM
    corners = box_corners(boxes, sizes).reshape(-1, 4, 2)[:, [0, 3, 2, 1, 0]]
    faces = [np.stack([ring[:, :-1], ring[:, 1:]], axis=2).reshape(-1, 2, 2) for ring in (rims, corners)]
    return np.concatenate(faces)


def box_corners(boxes: Array, sizes: Array) -> Array:
    """(4b,2) m: the corners of boxes (b,>=3) of sizes (b,2), counter-clockwise."""
    turned = np.array([(math.cos(turn), math.sin(turn)) for turn in boxes[:, 2].tolist()]).reshape(-1, 2, 1)
    c, s = turned[:, 0], turned[:, 1]
    along, aside = (BOX_CORNERS[:, axis] * sizes[:, axis, None] for axis in (0, 1))
    x, y = boxes[:, :1] + c * along - s * aside, boxes[:, 1:2] + s * along + c * aside
    return np.stack([x, y], axis=2).reshape(-1, 2)
