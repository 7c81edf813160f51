"""Geometry that pictures need: ellipses, rooms' label places, points of a scan in the world.

What a picture is drawn from: plain data, so that no drawing code reaches into the environment.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt

from mecp_env.core.carriers import Array, Bools, Bytes, Ints
from mecp_env.core.se2 import compose, polar_to_points, to_map
from mecp_env.render import palette
from mecp_env.render.palette import RGB, room_colour
from mecp_env.slam.messages import Belief, Cell, Decision, SemanticGrid
from mecp_env.slam.output import SlamOutput

ITEMS = (  # shown name, format; left out where a metric is missing
    ("rooms", "{rooms_found:.0f}/{rooms:.0f}"),
    ("doors", "{doors_found:.0f}/{doors:.0f}"),
    ("coverage", "{coverage:.1%}"),
    ("pose error", "{pose_error_cm:.1f} cm"),
    ("landmarks", "{landmarks:.0f}"),
)

KNOWN_GROUND = 4  # from this `GoalKind` on, goals are on known ground


@dataclass(frozen=True, slots=True, eq=False)
class SceneView:
    """One moment of an episode: the truth, the estimate, and the goal of the agent.

    On a log there is no truth but perhaps a reference path: no segments, and the world frame is that of the map.
    """

    segments: Array  # (S,2,2) m, world frame: faces of all solids ring by ring, free space on the left; none on a log
    T_world_robot: Array  # (3,) true pose
    T_world_map: Array  # (3,) true pose at reset: where the map frame lies
    path_world: Array  # (n,2) m, world frame: where the robot has been
    path_map: Array  # (n,2) m, map frame: its estimated positions
    slam_output: SlamOutput
    moving: Array = field(default_factory=lambda: np.empty((0, 2, 2)))  # (m,2,2) m, world: faces of pedestrians, boxes
    robot_radius_m: float = 0.22
    p_goals: Array = field(default_factory=lambda: np.empty((0, 2)))  # (g,2) m, map frame
    goal_kinds: Ints = field(default_factory=lambda: np.empty(0, np.int64))  # (g,) GoalKind
    goal_figures: Mapping[str, Array] = field(default_factory=dict)  # name -> (g,): length of the path, ...
    target: int = -1  # index of the goal the robot drives to, or -1
    title: str = ""
    metrics: Mapping[str, float] = field(default_factory=dict)  # `summary` shows some of them

    @property
    def bounds(self) -> Array:
        """(2,2) m, world frame: lower left and upper right corner of the building; without truth, of the map."""
        points = self.segments.reshape(-1, 2) if len(self.segments) else self.to_world(self._mapped())
        return np.stack([points.min(axis=0), points.max(axis=0)])

    def _mapped(self) -> Array:
        """(n,2) m, map frame: the path, the landmarks, and the corners of what the grid knows."""
        grid, belief = self.slam_output.grid, self.slam_output.belief
        cells = np.argwhere(grid.label != Cell.UNKNOWN)
        ends = np.array([cells.min(axis=0), cells.max(axis=0) + 1])[:, ::-1] if len(cells) else np.empty((0, 2))
        return np.vstack([self.path_map, belief.T_map_robot[:2], belief.p_map, grid.origin + grid.resolution_m * ends])

    def to_world(self, p_map: Array) -> Array:
        """Points (n,2) m of the map in the world frame."""
        return to_map(self.T_world_map, np.ascontiguousarray(p_map, dtype=np.float64))


def summary(metrics: Mapping[str, float]) -> list[tuple[str, str]]:
    """Pairs of a name and a readable value, as far as `metrics` has them (`pose_error_m` is shown in cm)."""
    error = {"pose_error_cm": 100.0 * metrics["pose_error_m"]} if "pose_error_m" in metrics else {}
    return filled(ITEMS, {**metrics, **error})


def filled(items: Iterable[tuple[str, str]], metrics: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Names with filled formats, of those whose metrics there are."""
    found = list[tuple[str, str]]()
    for name, form in items:
        with suppress(KeyError):
            found.append((name, form.format(**metrics)))
    return found


def loops(segments: Array) -> list[Array]:
    """Closed rings (k,2) of faces (S,2,2) that are in order, the largest first; a ring around a solid is clockwise."""
    follows = np.isclose(segments[1:, 0], segments[:-1, 1]).all(axis=1)
    rings = [ring[:, 0] for ring in np.split(segments, 1 + np.flatnonzero(~follows)) if len(ring)]
    return sorted(rings, key=lambda ring: -abs(signed_area(ring)))


def signed_area(ring: Array) -> float:
    """Area of a ring (k,2), m^2: positive when it runs counter-clockwise."""
    after = np.roll(ring, -1, axis=0)
    return float(0.5 * np.sum(ring[:, 0] * after[:, 1] - ring[:, 1] * after[:, 0]))


ELLIPSE_MAGNIFIED = 5.0  # of the corners of one scan
MAGNIFICATIONS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)  # of the ellipses of a map; legends name the one that was taken
READABLE_M = 0.25  # the usual ellipse is drawn no larger
CHI2_95 = 5.991  # 2 degrees of freedom
TURN = np.linspace(0.0, 2.0 * math.pi, 33)[:-1]
DECISION_COLOURS = {
    Decision.LANDMARK: palette.ESTIMATE,
    Decision.PROVISIONAL: palette.DOOR,
    Decision.NEW: palette.GOAL,
    Decision.IGNORED: palette.FAINT,
}
WIDE = (2.5, 1.0)  # a name is so many times as wide as high


def ellipse(mean: Array, cov: Array, magnified: float = 1.0) -> Array:
    """Ring (32,2) of the 95 % ellipse of a point (2,) with covariance (2,2), its axes `magnified` times as long."""
    values, axes = np.linalg.eigh(cov)
    radii = magnified * np.sqrt(CHI2_95 * np.maximum(values, 0.0))
    ring: Array = mean + np.column_stack([radii[0] * np.cos(TURN), radii[1] * np.sin(TURN)]) @ axes.T
    return ring


def closed(ring: Array) -> Array:
    """The ring (k,2) as a line (k+1,2) back to its first point."""
    line: Array = np.vstack([ring, ring[:1]])
    return line


def wall_strips(segments: Array, thick_m: float = 0.12) -> Array:
    """Strips (S,4,2) behind the faces (S,2,2): the outside of a building has no face, its walls are drawn so thick."""
    start, end = segments[:, 0], segments[:, 1]
    along = thick_m * (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    behind = np.stack([along[:, 1], -along[:, 0]], axis=1)  # free space is on the left
    return np.stack([start - along, end + along, end + along + behind, start - along + behind], axis=1)


def beam_ends(output: SlamOutput, T_world_robot: Array) -> tuple[Array, Bools]:
    """Ends of all beams (B,2) in the frame of the pose, m, and which of them hit something (B,)."""
    z = np.column_stack([output.beams.ranges, output.beams.bearings])
    return to_map(compose(T_world_robot, output.T_robot_laser), polar_to_points(z)), output.beams.hit


def beam_fan(output: SlamOutput, T_world_robot: Array) -> Array:
    """Outline (n,2) m of what the beams cover, in the frame of the pose: with the laser, where it has a blind side."""
    ends, _ = beam_ends(output, T_world_robot)
    laser = compose(T_world_robot, output.T_robot_laser)[:2]
    return np.vstack([ends, laser]) if output.beams.blind else ends


def positions(belief: Belief) -> dict[int, Array]:
    """Landmark id -> mean (2,) m, map frame."""
    return {int(name): mean for name, mean in zip(belief.ids, belief.p_map, strict=True)}


def polygon_rings(view: SceneView) -> list[tuple[Array, RGB]]:
    """Rings (k,2) m, world frame, of the known polygons of landmarks only, with their colours, the largest first."""
    output, where = view.slam_output, positions(view.slam_output.belief)
    whole = [p for p in output.map_polygons if all(int(i) in where for i in p.ids)]
    rings = [(np.array([where[int(i)] for i in p.ids]), room_colour(output.graph.resolve(p.room))) for p in whole]
    rings.sort(key=lambda pair: -float(np.ptp(pair[0], axis=0).prod()))
    return [(view.to_world(ring), colour) for ring, colour in rings]


def door_lines(view: SceneView) -> tuple[list[Array], list[Array]]:
    """Lines (2,2) m, world frame: faces of doors between jambs that are landmarks, and door candidates."""
    graph, where = view.slam_output.graph, positions(view.slam_output.belief)
    pairs = [pair for door in graph.doors for pair in (door.jambs, door.other_face) if pair is not None]
    faces = [np.array([where[a], where[b]]) for a, b in pairs if a in where and b in where]
    return [view.to_world(face) for face in faces], [view.to_world(one.ends) for one in graph.candidates]


def landmark_ellipses(view: SceneView) -> list[Array]:
    """Magnified 95 % ellipses (32,2) m, world frame, of the landmarks."""
    belief, factor = view.slam_output.belief, magnification(view.slam_output.belief)
    pairs = zip(belief.p_map, belief.covs, strict=True)
    return [view.to_world(ellipse(mean, cov, factor)) for mean, cov in pairs]


def magnification(belief: Belief) -> float:
    """How many times larger than life the ellipses of a map are drawn: those of a good map are smaller than a pixel."""
    if not len(belief.covs):
        return MAGNIFICATIONS[0]
    usual = math.sqrt(CHI2_95 * float(np.median(belief.covs.trace(axis1=1, axis2=2))) / 2.0)
    return max((k for k in MAGNIFICATIONS if k * usual <= READABLE_M), default=MAGNIFICATIONS[0])


def recognised(view: SceneView) -> tuple[Array, Array]:
    """The polygon of the scan (k,2) m, world frame, that was recognised, and those of its vertices that are landmarks.

    Both are empty where none was.
    """
    output = view.slam_output
    if not 0 <= output.match.polygon < len(output.polygons) or not len(output.match.recognised()):
        return np.empty((0, 2)), np.empty((0, 2))
    corners = output.polygons[output.match.polygon].corners
    ring = to_map(output.T_map_laser, polar_to_points(output.polygon_corners.z[corners]))
    known = output.match.ids[corners[corners < len(output.match.ids)]]
    where = positions(output.belief)
    vertices = [where[name] for name in known.tolist() if name in where]
    return view.to_world(ring), view.to_world(np.array(vertices).reshape(-1, 2))


def room_labels(output: SlamOutput, path: Array | None = None) -> dict[int, Array]:
    """Room id -> where to write its name: the widest place (2,) of its cells, away from a path (n,2), map frame."""
    grid = output.grid
    free, labels = np.ones_like(grid.room, np.bool_), {}
    if path is not None:
        cells = np.floor((path - grid.origin) / grid.resolution_m).astype(np.int64)
        free[cells[:, 1].clip(0, len(free) - 1), cells[:, 0].clip(0, free.shape[1] - 1)] = False
    for room in output.graph.rooms:
        inside = np.pad((grid.room == room) & free, 1)
        if inside.any():
            depth = distance_transform_edt(inside, sampling=WIDE)
            row, col = np.unravel_index(np.argmax(depth), depth.shape)
            labels[room] = grid.origin + grid.resolution_m * (np.array([col, row]) - 0.5)
    return labels


def cell_colours(grid: SemanticGrid, walls: bool = True) -> Bytes:
    """(H,W,3) colour of every cell; without `walls`, these look like what lies beside them."""
    rooms = np.array([palette.mix(palette.FREE, palette.room_colour(i), 0.2) for i in range(len(palette.ROOMS))])
    colours = np.empty((*grid.label.shape, 3), np.uint8)
    colours[:] = palette.UNSEEN
    free = grid.label == Cell.FREE
    colours[free] = palette.FREE
    named = free & (grid.room >= 0)
    colours[named] = rooms[grid.room[named] % len(palette.ROOMS)]
    if walls:
        colours[grid.label == Cell.OCCUPIED] = palette.SOLID
    else:
        nearest = distance_transform_edt(grid.label == Cell.OCCUPIED, return_distances=False, return_indices=True)
        colours = colours[nearest[0], nearest[1]]
    colours[grid.label == Cell.DOOR] = palette.mix(palette.DOOR, palette.FREE, 0.55)
    return colours
