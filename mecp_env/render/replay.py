"""A page that plays a run: what it needs of every step, kept as the run goes on, and written as whole numbers.

`replay_page` has the page itself, which is read without the messages of the estimator.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mecp_env.core.carriers import Array, Bytes
from mecp_env.core.se2 import polar_to_points
from mecp_env.render import palette
from mecp_env.render.replay_page import PackedGrid, ReplayError, changed_cells, changed_rows, read_page, write_page
from mecp_env.render.shapes import SceneView, loops, signed_area
from mecp_env.slam.messages import Belief, Cell, Corners, Decision, Match, Reason, SemanticGrid
from mecp_env.slam.output import SlamOutput

__all__ = ["Recorder", "ReplayError", "read_page", "write_page"]

MOST_FRAMES = 1500  # a longer run keeps every second step, then every fourth, ...
MOST_BEAMS = 180  # of a scan that are drawn
CM, MRAD, MM2 = 100.0, 1000.0, 1e6  # lengths, angles and covariances are written in these units
CURVES = (  # metrics that are drawn over time, as far as a run has them, and their factor
    *(("coverage", 1e4), ("correct_coverage", 1e4), ("pose_error_m", 1e4), ("nees", 100.0), ("landmarks", 1.0)),
    *(("rooms_found", 1.0), ("rooms", 1.0), ("doors_found", 1.0), ("doors", 1.0), ("contacts", 1.0)),
)
REWARD = "reward_"


@dataclass(slots=True, eq=False)
class Frame:
    """One step in whole numbers: what is written as it is, and what only where it changed."""

    row: dict[str, Any]
    grid: PackedGrid
    landmarks: dict[int, list[int]]
    map: str  # as JSON
    recognised: int  # landmarks of the polygon of the map that was recognised

    def written(self, **changes: Any) -> dict[str, Any]:
        """As a page has it; what there is none of is left out."""
        row = self.row | changes
        return {name: value for name, value in row.items() if not (value is None or value is False or value == [])}


@dataclass(slots=True, eq=False)
class Recorder:
    """Keeps the steps of one run; `run` is what the page needs to draw it."""

    period_s: float = 0.4
    frames: list[Frame] = field(default_factory=list)
    every: int = 1
    steps: int = 0
    earned: dict[str, float] = field(default_factory=dict)  # reward by term, of the steps so far
    view: SceneView | None = None  # of the last step
    version: int = -1  # of the last grid

    def look(self, view: SceneView, info: Mapping[str, Any] | None = None, seconds: float | None = None) -> None:
        """Keep a step; `info` of the environment has the terms of its reward, `seconds` is its time in a log."""
        self.earned |= earned(self.earned, info or {})
        if self.steps % self.every == 0:
            self.frames.append(self._frame(view, self.steps * self.period_s if seconds is None else seconds))
        if len(self.frames) > MOST_FRAMES:
            self.frames = self.frames[::2]
            self.every *= 2
        self.view = view
        self.steps += 1

    def _frame(self, view: SceneView, seconds: float) -> Frame:
        output = view.slam_output
        matched = self._matched(output)
        units = dict(CURVES) | dict.fromkeys(self.earned, 100.0)
        curves = {name: view.metrics[name] for name, _ in CURVES if name in view.metrics} | self.earned
        row = {
            "step": self.steps,
            "time": whole(seconds, 100.0),
            "truth": pose(view.T_world_robot) if len(view.segments) else None,
            "pose": pose(output.belief.T_map_robot),
            "cov": whole(upper(output.belief.pose_cov[:2, :2]), MM2),
            "turn_sigma": whole(np.sqrt(output.belief.pose_cov[2, 2]), MRAD),
            "ranges": whole(beams_shown(output)[1], CM),
            "corners": corner_rows(output.corners, output.match, output.associated),
            "polygons": [whole(points_of(output)[p.corners], CM) for p in output.polygons],
            "chosen": output.associated.polygon,
            "matched": matched,
            "room": output.graph.resolve(output.graph.current),
            "goals": goal_rows(view),
            "target": view.target,
            "moving": [whole(ring, CM) for ring in loops(view.moving)],
            "confidence": whole(output.confidence, MRAD),
            "lost": not output.localised,
            "curves": {name: whole(value, units[name]) for name, value in curves.items()},
        }
        recognised = len(output.match.recognised()) if matched else 0
        return Frame(row, self._packed(output.grid), landmark_rows(output.belief), map_of(output), recognised)

    def _matched(self, output: SlamOutput) -> list[int]:
        """The landmarks of the polygon of the map that was recognised, as it was before."""
        before = self.view.slam_output.map_polygons if self.view is not None else ()
        known = output.associated.known
        return before[known].ids.tolist() if 0 <= known < len(before) else []

    def _packed(self, grid: SemanticGrid) -> PackedGrid:
        if not self.frames or self.version != grid.version:
            self.version = grid.version
            return PackedGrid.of(codes(grid), grid.origin)
        return self.frames[-1].grid

    def run(self, title: str, result: str = "") -> dict[str, Any]:
        """All that was kept, as plain data. Call it once there is a step."""
        assert self.view is not None
        view, output = self.view, self.view.slam_output
        place, size, cells = changed_cells([frame.grid for frame in self.frames], output.grid.resolution_m)
        return {
            "title": title,
            "result": result,
            "robot_cm": whole(view.robot_radius_m, CM),
            "walls": [whole(ring, CM) for ring in loops(view.segments)],
            "solid": [signed_area(ring) < 0.0 for ring in loops(view.segments)],
            "map_in_world": pose(view.T_world_map),
            "bearings": whole(beams_shown(output)[0], MRAD),
            "laser": pose(output.T_robot_laser),
            "grid": {"origin": whole(place, CM), "size": size, "cell": output.grid.resolution_m},
            "rooms": list(map(list, palette.ROOMS)),
            "reasons": {int(reason): REASONS[reason] for reason in Reason},
            "kinds": KINDS,
            "decisions": {int(decision): DECISIONS[decision] for decision in Decision},
            "curve_units": dict(CURVES) | dict.fromkeys(self.earned, 100.0),
            **self._written(cells),
            "opens_at": self._telling(),
        }

    def _written(self, cells: list[list[int]]) -> dict[str, Any]:
        """The frames with what changed in each, and the maps that they name, each once."""
        maps = {name: place for place, name in enumerate(dict.fromkeys(frame.map for frame in self.frames))}
        rows = zip(self.frames, cells, changed_rows(frame.landmarks for frame in self.frames), strict=True)
        frames = [frame.written(cells=runs, landmarks=marks, map=maps[frame.map]) for frame, runs, marks in rows]
        return {"frames": frames, "maps": list(map(json.loads, maps))}

    def _telling(self) -> int:
        """The frame to open at: a polygon of the map is recognised, with as many landmarks as ever, half-way or so."""
        count = [frame.recognised for frame in self.frames]
        first, last = len(count) // 4, 1 + 3 * len(count) // 4
        return first + int(np.argmax(count[first:last])) if any(count[first:last]) else len(count) // 2


def earned(before: Mapping[str, float], info: Mapping[str, Any]) -> dict[str, float]:
    """The terms of the reward in the info of a step, added to those of the steps before."""
    terms = {name: float(value) for name, value in info.items() if name.startswith(REWARD)}
    return {name: before.get(name, 0.0) + value for name, value in terms.items()}


def whole(values: Any, unit: float) -> Any:
    """Values as whole numbers of 1 / `unit`, nan as None; lists of them for arrays."""
    return np.asarray(_whole(np.round(np.asarray(values, np.float64) * unit)), np.object_).tolist()


_whole = np.frompyfunc(lambda value: int(value) if math.isfinite(value) else None, 1, 1)


def pose(T: Array) -> list[int]:
    """x, y in cm and the heading in mrad."""
    return [*whole(T[:2], CM), whole(T[2], MRAD)]


def upper(covs: Array) -> Array:
    """(...,3) xx, xy, yy of covariances (...,2,2)."""
    return covs[..., (0, 0, 1), (0, 1, 1)]


def beams_shown(output: SlamOutput) -> tuple[Array, Array]:
    """Bearings (b,) rad and ranges (b,) m of evenly spaced beams; 0 where one hit nothing."""
    beams = output.beams
    every = -(-len(beams.ranges) // MOST_BEAMS)
    ranges = np.where(beams.hit, beams.ranges, 0.0)
    return beams.bearings[::every], ranges[::every]


def points_of(output: SlamOutput) -> Array:
    """(n,2) m, laser frame: the corners that polygons have as vertices."""
    return polar_to_points(output.polygon_corners.z)


def corner_rows(corners: Corners, match: Match, associated: Match) -> list[list[Any]]:
    """For each corner x, y in cm (laser frame), the normals of its faces, NIS, kind, convex, decision, reason, id, and
    decision and id as the associator had them.
    """
    if not len(corners):
        return []
    places, normals = whole(polar_to_points(corners.z), CM), whole(corners.normals, MRAD)
    nis = whole(match.nis, 100.0)
    columns = corners.kind, corners.convex, match.decision, match.reason, match.ids, associated.decision, associated.ids
    rows = zip(places, normals, nis, *(np.asarray(column).astype(int).tolist() for column in columns), strict=True)
    return [[*place, *faces, fit, *rest] for place, faces, fit, *rest in rows]


def goal_rows(view: SceneView) -> list[list[int]]:
    """For each goal x, y in cm, its kind, path, opening and predicted sigma in cm, predicted gain in 1/100 nat."""
    count, units = len(view.p_goals), {"path_m": CM, "size_m": CM, "sigma_m": CM, "gain_nat": 100.0}
    figures = [whole(view.goal_figures.get(name, np.zeros(count)), unit) for name, unit in units.items()]
    rows = zip(whole(view.p_goals, CM), view.goal_kinds.tolist(), *figures, strict=True)
    return [[*place, *rest] for place, *rest in rows] if count else []


def landmark_rows(belief: Belief) -> dict[int, list[int]]:
    """For each landmark x, y in cm and its covariance xx, xy, yy in mm^2."""
    places = whole(belief.p_map, CM)
    covs = whole(upper(belief.covs), MM2)
    return {name: [*p, *c] for name, p, c in zip(belief.ids.tolist(), places, covs, strict=True)}


def map_of(output: SlamOutput) -> str:
    """Polygons with their rooms, doors by the landmarks of their jambs, and gaps that are no doors yet."""
    graph = output.graph
    pairs = [pair for door in graph.doors for pair in (door.jambs, door.other_face) if pair is not None]
    found = {
        "polygons": [[graph.resolve(p.room), *p.ids.tolist()] for p in output.map_polygons],
        "doors": [list(pair) for pair in pairs],
        "gaps": [whole(gap.ends, CM) for gap in graph.candidates],
        "rooms": list(graph.rooms),
    }
    return json.dumps(found)


def codes(grid: SemanticGrid) -> Bytes:
    """(H,W) 0 unknown, 1 occupied, 2 door, 3 free in no room, 4 + i free in a room of colour i."""
    code = np.array([0, 3, 1, 2], np.uint8)[grid.label]  # by the order of `Cell`
    named = (grid.label == Cell.FREE) & (grid.room >= 0)
    code[named] = 4 + grid.room[named] % len(palette.ROOMS)
    return code


KINDS = (  # of goals, by their numbers
    *("open edge", "gap that may be a door", "frontier", "door"),
    *("place on known ground", "wait", "look around"),
)
DECISIONS = {
    Decision.LANDMARK: "landmark",
    Decision.PROVISIONAL: "track",
    Decision.NEW: "new",
    Decision.IGNORED: "ignored",
}
REASONS = {
    Reason.POLYGON: "vertex of the polygon that was recognised",
    Reason.ROOM: "near a landmark of this room, at the pose that the polygon implies",
    Reason.JOINT: "jointly compatible with the other corners",
    Reason.THROUGH_DOOR: "seen through a door",
    Reason.TRACK: "follows a corner that is not confirmed yet",
    Reason.UNSEEN: "nothing on the map is near",
    Reason.AMBIGUOUS: "more than one landmark fits, or one nearly fits",
    Reason.REFUSED: "known, but does not fit the predicted pose",
    Reason.IDENTITY: "known correspondence",
    Reason.DYNAMIC: "on something that moves",
    Reason.NOT_LOCALISED: "the pose is searched for: nothing is matched",
    Reason.RELOCALISED: "by it and others the pose was found again",
}
