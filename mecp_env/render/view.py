"""What a picture is drawn from: plain data, so that no drawing code reaches into the environment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mecp_env.core.array_types import Array, Ints
from mecp_env.core.se2 import to_map
from mecp_env.slam.messages import Cell
from mecp_env.slam.output import SlamOutput

# shown name, format, and the names of the metrics it is made of; left out where one of them is missing
ITEMS = (
    ("rooms", "{:.0f}/{:.0f}", ("rooms_found", "rooms")),
    ("doors", "{:.0f}/{:.0f}", ("doors_found", "doors")),
    ("coverage", "{:.1%}", ("coverage",)),
    ("pose error", "{:.1f} cm", ("pose_error_cm",)),
    ("landmarks", "{:.0f}", ("landmarks",)),
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
    known = dict(metrics)
    if "pose_error_m" in known:
        known["pose_error_cm"] = 100.0 * known["pose_error_m"]
    return [
        (name, form.format(*(known[key] for key in keys)))
        for name, form, keys in ITEMS
        if all(key in known for key in keys)
    ]


def loops(segments: Array) -> list[Array]:
    """Closed rings (k,2) of faces (S,2,2) that are in order, the largest first; a ring around a solid is clockwise."""
    follows = np.isclose(segments[1:, 0], segments[:-1, 1]).all(axis=1)
    rings = [ring[:, 0] for ring in np.split(segments, 1 + np.flatnonzero(~follows)) if len(ring)]
    return sorted(rings, key=lambda ring: -abs(signed_area(ring)))


def signed_area(ring: Array) -> float:
    """Area of a ring (k,2), m^2: positive when it runs counter-clockwise."""
    after = np.roll(ring, -1, axis=0)
    return float(0.5 * np.sum(ring[:, 0] * after[:, 1] - ring[:, 1] * after[:, 0]))
