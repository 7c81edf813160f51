"""A constructed state of an episode: two rooms with a door between them, half explored."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.se2 import to_robot
from mecp_env.render.view import SceneView
from mecp_env.slam.messages import (
    Belief,
    Candidate,
    Cell,
    Corners,
    Door,
    Doorways,
    MapPolygon,
    Match,
    MergedScan,
    RoomGraph,
    Segments,
    SemanticGrid,
)
from mecp_env.slam.output import SlamOutput

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
    rings = [np.array(ring, float) for ring in (OUTER, INNER)]
    return np.concatenate([np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in rings])


def cast(segments: Array, T: Array, bearings: Array) -> Array:
    """(B,) m: ranges of beams from pose T, plain and slow."""
    angle = T[2] + bearings
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)[:, None]
    edge, to_start = segments[:, 1] - segments[:, 0], segments[:, 0] - T[:2]
    across = direction[..., 0] * edge[:, 1] - direction[..., 1] * edge[:, 0]
    along = (to_start[:, 0] * edge[:, 1] - to_start[:, 1] * edge[:, 0]) / across
    share = (to_start[:, 0] * direction[..., 1] - to_start[:, 1] * direction[..., 0]) / across
    ranges: Array = np.where((along > 0) & (share >= 0) & (share <= 1), along, 30.0).min(axis=1)
    return ranges


def grid(T: Array) -> SemanticGrid:
    """The left room free, its walls occupied, the door, a strip of the right room; not square."""
    res, origin = 0.1, np.array([-3.0, -4.0])
    rows, cols = np.mgrid[0:90, 0:140]
    p_map = origin + res * (np.stack([cols.ravel(), rows.ravel()], axis=1) + 0.5)
    c, s = np.cos(T[2]), np.sin(T[2])
    x, y = T[0] + c * p_map[:, 0] - s * p_map[:, 1], T[1] + s * p_map[:, 0] + c * p_map[:, 1]
    near_door = (y > 1.5) & (y < 2.4)
    free = ((x > 0) & (x < 5) | (x > 5.1) & (x < 7)) & (y > 0) & (y < 4)
    wall = (x > -0.1) & (x < 5.1) & (y > -0.1) & (y < 4.1) & ~free
    label = np.select([free, wall & near_door & (x > 4.5), wall], [Cell.FREE, Cell.DOOR, Cell.OCCUPIED], Cell.UNKNOWN)
    room = np.select([free & (x < 5), free], [0, 1], -1)
    shape = rows.shape
    return SemanticGrid(
        label=label.reshape(shape).astype(np.uint8),
        polygon=(free & (x < 5)).reshape(shape),
        room=room.reshape(shape).astype(np.int16),
        origin=origin,
        resolution_m=res,
        version=1,
    )


def corners() -> Corners:
    """The four corners of the left room, seen from the robot; the last one is not a site."""
    p_robot = to_robot(T_WORLD_ROBOT, np.array(LEFT, float))
    return Corners(
        z=np.column_stack([np.hypot(*p_robot.T), np.arctan2(p_robot[:, 1], p_robot[:, 0])]),
        cov=np.diag([1e-3, 1e-4] * 4),
        kind=np.array([0, 1, 2, 0]),
        convex=np.zeros(4, bool),
        normals=np.zeros((4, 2)),
        beyond=np.array([-1, -1, -1, 0]),
        sites=np.array([True, True, True, False]),
        doorways=Doorways(np.array([[1, 2]]), np.array([0.9]), np.array([True])),
    )


def output() -> SlamOutput:
    """The SLAM output in that state."""
    bearings = np.radians(np.arange(-179.75, 180.0, 0.5))
    ranges = cast(faces(), T_WORLD_ROBOT, bearings)
    beams = MergedScan(ranges, bearings, ranges < 30.0, np.ones(720, np.int64), 30.0, ranges, bearings)
    p_map = to_robot(T_WORLD_MAP, LANDMARKS)
    covs = np.array([[[0.004, 0.001], [0.001, 0.002]]]) * np.linspace(0.1, 1.0, len(p_map))[:, None, None]
    T_map_robot = np.append(to_robot(T_WORLD_MAP, T_WORLD_ROBOT[None, :2])[0], T_WORLD_ROBOT[2] - T_WORLD_MAP[2])
    belief = Belief(T_map_robot, np.diag([0.0005, 0.0002, 0.0001]), np.arange(len(p_map)), p_map, covs)
    door = Door(id=0, jambs=(4, 5), other_face=None, rooms=(0, 1), sightings=5)
    gap = to_robot(T_WORLD_MAP, np.array([[9.1, 1.0], [9.1, 1.9]]))
    candidate = Candidate(ends=gap, ids=(-1, -1), room=1, sightings=1, last_step=3)
    known = MapPolygon(np.arange(4), np.empty((0, 4)), room=0)
    right = MapPolygon(np.arange(6, 10), np.empty((0, 4)), room=1)
    none = np.full(4, -1)
    nothing = np.empty(0, np.int64)
    match = Match(none, none + 4, none + 1, np.full(4, np.nan), -1, -1)
    return SlamOutput(
        step=12,
        beams=beams,
        segments=Segments(np.empty((0, 2, 2)), np.empty((0, 2)), np.empty((0, 2, 2)), nothing, nothing, nothing, 0),
        corners=corners(),
        polygons=(),
        associated=match,
        match=match,
        belief=belief,
        graph=RoomGraph(0, False, (0, 1), (door,), (candidate,), {}),
        map_polygons=(known, right),
        grid=grid(T_WORLD_MAP),
        diverged=False,
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
        "metrics": {
            "rooms_found": 1,
            "rooms": 2,
            "doors_found": 1,
            "doors": 1,
            "coverage": 0.731,
            "pose_error_m": 0.0123,
        },
    }
    return SceneView(**(fields | changes))  # type: ignore[arg-type]
