"""A toy world for grid and planning: rectangles, exact rays, exact segments, a point robot. No estimator."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import shapely

from mecp_env.core.se2 import compose, to_map, to_robot
from mecp_env.slam.config import GridConfig
from mecp_env.slam.grid import GridPainter
from mecp_env.slam.messages import Belief, EdgeLabel, MapPolygon, MergedScan, RoomGraph, Segments, SemanticGrid
from mecp_env.slam.output import SlamOutput
from tests.slam import make
from tests.slam.scans import distances

RINGS = [  # of two rooms with a passage between them, and of a pillar
    [[0, 0], [6, 0], [6, 1.5], [6.12, 1.5], [6.12, 0], [32.12, 0], [32.12, 4], [6.12, 4], [6.12, 2.4], [6, 2.4]],
    [[12, 1.8], [12, 2.2], [12.4, 2.2], [12.4, 1.8]],
]
RINGS[0] += [[6, 4], [0, 4]]
FLOOR = shapely.Polygon(RINGS[0], RINGS[1:])
FACES = np.array([[a, b] for ring in RINGS for a, b in zip(ring, [*ring[1:], ring[0]], strict=True)], np.float64)
A_CORNERS, A_JAMBS = [[0, 0], [6, 0], [6, 4], [0, 4]], [[6, 1.5], [6, 2.4]]
B_JAMBS, B_CORNERS = [[6.12, 1.5], [6.12, 2.4]], [[6.12, 0], [32.12, 0], [32.12, 4], [6.12, 4]]
LANDMARKS = np.array([*A_CORNERS, *A_JAMBS, *B_JAMBS, *B_CORNERS], np.float64)
BEARINGS = -np.pi + 2 * np.pi * (np.arange(720) + 1) / 720
HERE = np.zeros(3)


def cast_rays(T_world_robot: np.ndarray, faces: np.ndarray = FACES) -> tuple[np.ndarray, np.ndarray]:
    """Range (720,) and face (720,) of each beam."""
    far = distances(faces - T_world_robot[:2], BEARINGS + T_world_robot[2])
    return far.min(axis=1), far.argmin(axis=1)


def look(
    T_world_robot: np.ndarray, rng: np.random.Generator | None = None, sigma: float = 0.0
) -> tuple[MergedScan, Segments]:
    """MergedScan, with noise, and the segments a perfect front end would fit to them."""
    ranges, face = cast_rays(T_world_robot)
    beams = make.beams(ranges + (0.0 if rng is None else sigma * rng.standard_normal(720)), BEARINGS, hit=True)
    starts = np.flatnonzero(face != np.roll(face, 1))
    roll = int(starts[0])
    rows: list[Any] = []
    for first, last in zip(starts, [*starts[1:], starts[0] + 720], strict=True):
        if last - first >= 5:
            rows.append(segment(first - roll, last - 1 - roll, roll, T_world_robot, FACES[face[first]], ranges))
    return beams, make.segments(*zip(*rows, strict=True), roll=roll)


def segment(first: int, last: int, roll: int, T: np.ndarray, face: np.ndarray, ranges: np.ndarray) -> tuple[Any, ...]:
    """End points, line and positions of the beams first..last, which all hit one face."""
    beams = (roll + np.array([first, last])) % 720
    points = ranges[beams, None] * np.stack([np.cos(BEARINGS[beams]), np.sin(BEARINGS[beams])], axis=1)
    a, b = to_robot(T, face)
    normal = np.array([b[1] - a[1], a[0] - b[0]]) / np.hypot(*(b - a))
    normal *= 1.0 if normal @ a >= 0 else -1.0
    return points, np.array([np.arctan2(normal[1], normal[0]), normal @ a]), first, last


@dataclass
class Toy:
    """The world, its estimate, and a robot that follows commands exactly. Map = world moved by `T_map_world`."""

    T_world_robot: np.ndarray
    T_map_world: np.ndarray = field(default_factory=lambda: HERE.copy())
    sigma: float = 0.0  # m, noise of the beams
    pose_sigma: float = 0.0  # m and 0.1 rad, error of the believed pose
    confirmed: bool = True  # the door is known
    seed: int = 0

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.painter = GridPainter(GridConfig())
        self.p_map = to_map(self.T_map_world, LANDMARKS)
        self.rooms: tuple[int, ...] = (0,)
        self.polygons: list[MapPolygon] = []
        self.step = 0
        self.contact = False
        self.command = (0.0, 0.0)

    @property
    def current(self) -> int:
        return int(self.T_world_robot[0] > 6.06)

    def belief(self) -> Belief:
        """The pose with its error, all landmarks."""
        T = compose(self.T_map_world, self.T_world_robot)
        T = T + self.pose_sigma * self.rng.standard_normal(3) * np.array([1.0, 1.0, 0.1])
        return make.belief(T, self.p_map, pose_cov=1e-4)

    def graph(self) -> RoomGraph:
        """One door, or one candidate."""
        self.rooms = tuple(sorted({*self.rooms, self.current}))
        door = make.door(jambs=(4, 5), other_face=(6, 7), rooms=(0, 1 if 1 in self.rooms else -1), sightings=5)
        gaps = {"doors": (door,)} if self.confirmed else {"candidates": (make.candidate(self.p_map[[4, 5]]),)}
        return make.graph(self.current, self.rooms, in_doorway=abs(self.T_world_robot[0] - 6.06) < 0.3, **gaps)

    def add_polygon(self, ids: list[int], room: int, open_edges: tuple[int, ...] = ()) -> None:
        """A known polygon with whole edges of wall or open space."""
        labels = [EdgeLabel.OPEN if edge in open_edges else EdgeLabel.WALL for edge in range(len(ids))]
        self.polygons.append(make.map_polygon(ids, room, make.edges(*labels)))

    def output(self, completed: tuple[int, ...] = ()) -> SlamOutput:
        """The SLAM output of this step."""
        self.step += 1
        beams, segments = look(self.T_world_robot, self.rng, self.sigma)
        belief, graph = self.belief(), self.graph()
        ids, known = np.arange(len(self.p_map)), tuple(self.polygons)
        self.painter.complete(completed)
        grid = self.painter.paint(belief, beams, segments, ids, known, graph)
        seen = {"beams": beams, "segments": segments, "belief": belief, "graph": graph, "grid": grid}
        return make.output(step=self.step, map_polygons=known, **seen)

    def move(self, v: float, w: float, radius_m: float = 0.22) -> None:
        """A step of 0.4 s in ten steps, with limited acceleration; `contact` when the robot would touch a wall."""
        for _ in range(10):
            dv, dw = np.clip(v - self.command[0], -0.04, 0.04), np.clip(w - self.command[1], -0.2, 0.2)
            self.command = (self.command[0] + float(dv), self.command[1] + float(dw))
            ahead = compose(self.T_world_robot, np.array([0.04 * self.command[0], 0.0, 0.04 * self.command[1]]))
            blocked = wall_distance(ahead[:2]) < radius_m
            self.contact |= blocked
            self.T_world_robot = self.T_world_robot if blocked else ahead


def wall_distance(p_world: np.ndarray) -> float:
    """Distance from a point to the nearest face."""
    return float(FLOOR.boundary.distance(shapely.Point(p_world)))


def free_iou(
    grid: SemanticGrid, T_map_world: np.ndarray = HERE, area: tuple[float, float, float, float] | None = None
) -> float:
    """Intersection over union of the free cells of a grid and of the truth, on cells of 5 cm inside `area`."""
    x0, y0, x1, y1 = area or (-1.0, -1.0, 33.0, 5.0)
    x, y = np.meshgrid(np.arange(x0 + 0.025, x1, 0.05), np.arange(y0 + 0.025, y1, 0.05))
    p_world = np.stack([x.ravel(), y.ravel()], axis=1)
    label = labels_at(grid, to_map(T_map_world, p_world))
    believed, true = np.isin(label, (1, 3)), shapely.contains_xy(FLOOR, p_world)
    return float((believed & true).sum() / (believed | true).sum())


def labels_at(grid: SemanticGrid, p_map: np.ndarray) -> np.ndarray:
    """(n,) label of the cells at points of the map frame, 0 outside."""
    return layer_at(grid, grid.label, p_map)


def layer_at(grid: SemanticGrid, layer: np.ndarray, p_map: np.ndarray) -> np.ndarray:
    """(n,) value of a layer of the grid at points of the map frame, 0 outside."""
    cells = np.floor((p_map - grid.origin) / grid.resolution_m).astype(np.int64)
    known = (cells >= 0).all(axis=1) & (cells < np.array(layer.shape[::-1])).all(axis=1)
    values = np.zeros(len(p_map), layer.dtype)
    values[known] = layer[cells[known, 1], cells[known, 0]]
    return values
