"""A constructed state of an episode: two rooms with a door between them, half explored."""

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.se2 import to_map, to_robot
from mecp_env.render.shapes import SceneView
from mecp_env.slam.messages import Cell, Corners, Decision, Reason, SemanticGrid
from mecp_env.slam.output import SlamOutput
from tests.slam import make
from tests.slam.scans import cast, ring

Array = NDArray[np.float64]

OUTER = [(-0.1, -0.1), (-0.1, 4.1), (9.2, 4.1), (9.2, -0.1)]  # around the solid: clockwise
INNER = [(0, 0), (5, 0), (5, 1.5), (5.1, 1.5), (5.1, 0), (9.1, 0)]
INNER += [(9.1, 4), (5.1, 4), (5.1, 2.4), (5, 2.4), (5, 4), (0, 4)]
LEFT, DOOR, RIGHT = [(0, 0), (5, 0), (5, 4), (0, 4)], [(5, 1.5), (5, 2.4)], [(5.1, 0), (9.1, 0), (9.1, 4), (5.1, 4)]
LANDMARKS = np.array(LEFT + DOOR + RIGHT, float)
METRICS = {"rooms_found": 1, "rooms": 2, "doors_found": 1, "doors": 1, "coverage": 0.731, "pose_error_m": 0.0123}
T_WORLD_MAP = np.array([1.0, 1.0, 0.3])
T_WORLD_ROBOT = np.array([3.0, 2.2, 0.2])


def faces() -> Array:
    """(S,2,2) m: the faces of the two rooms' walls, free space on the left."""
    return np.concatenate([ring(*OUTER), ring(*INNER)])


def grid(T: Array) -> SemanticGrid:
    """The left room free, its walls occupied, the door, a strip of the right room; not square."""
    res, origin = 0.1, np.array([-3.0, -4.0])
    rows, cols = np.mgrid[0:90, 0:140]
    p_map = origin + res * (np.stack([cols.ravel(), rows.ravel()], axis=1) + 0.5)
    x, y = to_map(T, p_map).T
    near_door = (y > 1.5) & (y < 2.4)
    free = ((x > 0) & (x < 5) | (x > 5.1) & (x < 7)) & (y > 0) & (y < 4)
    wall = (x > -0.1) & (x < 5.1) & (y > -0.1) & (y < 4.1) & ~free
    label = np.select([free, wall & near_door & (x > 4.5), wall], [Cell.FREE, Cell.DOOR, Cell.OCCUPIED], Cell.UNKNOWN)
    room = np.select([free & (x < 5), free], [0, 1], -1)
    shape = rows.shape
    return make.grid(label.reshape(shape), room.reshape(shape), (free & (x < 5)).reshape(shape), origin=origin)


def corners() -> Corners:
    """The four corners of the left room, seen from the robot; the last one is not a site."""
    marks = {"kind": [0, 1, 2, 0], "convex": False, "beyond": [-1, -1, -1, 0], "sites": [True, True, True, False]}
    p_robot = to_robot(T_WORLD_ROBOT, np.array(LEFT, float))
    return make.corners(points=p_robot, cov=np.diag([1e-3, 1e-4] * 4), gaps=make.doorways([(1, 2)]), **marks)


def output() -> SlamOutput:
    """The SLAM output in that state."""
    bearings = np.radians(np.arange(-179.75, 180.0, 0.5))
    ranges = cast(to_robot(T_WORLD_ROBOT, faces().reshape(-1, 2)).reshape(-1, 2, 2), bearings)
    p_map = to_robot(T_WORLD_MAP, LANDMARKS)
    covs = np.array([[[0.004, 0.001], [0.001, 0.002]]]) * np.linspace(0.1, 1.0, len(p_map))[:, None, None]
    T_map_robot = np.append(to_robot(T_WORLD_MAP, T_WORLD_ROBOT[None, :2])[0], T_WORLD_ROBOT[2] - T_WORLD_MAP[2])
    gap = make.candidate(to_robot(T_WORLD_MAP, np.array([[9.1, 1.0], [9.1, 1.9]])), 1)
    match = make.match([-1] * 4, Decision.IGNORED, reason=Reason.POLYGON)
    return make.output(
        step=12,
        beams=make.beams(np.minimum(ranges, make.MAX_RANGE_M), bearings),
        segments=make.segments(),
        corners=corners(),
        associated=match,
        match=match,
        belief=make.belief(T_map_robot, p_map, pose_cov=np.diag([0.0005, 0.0002, 0.0001]), covs=covs),
        graph=make.graph(0, (0, 1), doors=(make.door(jambs=(4, 5), rooms=(0, 1), sightings=5),), candidates=(gap,)),
        map_polygons=(make.map_polygon(range(4)), make.map_polygon(range(6, 10), 1)),
        grid=grid(T_WORLD_MAP),
    )


def view(**changes: object) -> SceneView:
    """The moment; `changes` replace fields of the view."""
    path = np.column_stack([np.linspace(1.0, 3.0, 20), 1.0 + 1.2 * np.linspace(0.0, 1.0, 20) ** 2])
    fields: dict[str, object] = {
        "segments": faces(),
        "T_world_robot": T_WORLD_ROBOT,
        "T_world_map": T_WORLD_MAP,
        "path_world": path,
        "path_map": to_robot(T_WORLD_MAP, path + 0.03),
        "slam_output": output(),
        "p_goals": to_robot(T_WORLD_MAP, np.array([[6.5, 3.0], [8.0, 1.45], [5.0, 1.95]])),
        "goal_kinds": np.array([2, 1, 3]),
        "target": 1,
        "title": "two rooms, step 12",
        "metrics": METRICS,
    }
    return SceneView(**(fields | changes))  # type: ignore[arg-type]
