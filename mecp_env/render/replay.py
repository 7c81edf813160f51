"""A page that plays a run: what it needs of every step, kept as the run goes on, and written as whole numbers.

`replay_page` has the page itself, which is read without the messages of the estimator.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mecp_env.core.carriers import Array, Bytes, Ints
from mecp_env.core.se2 import polar_to_points
from mecp_env.render import palette
from mecp_env.render.replay_page import (
    PackedGrid,
    ReplayError,
    Versions,
    changed_cells,
    changed_rows,
    play_again,
    read_page,
    write_page,
)
from mecp_env.render.shapes import SceneView, loops, signed_area
from mecp_env.slam.messages import Cell, Corners, Decision, Match, Reason, SemanticGrid
from mecp_env.slam.output import SlamOutput

__all__ = ["Recorder", "ReplayError", "play_again", "read_page", "write_page"]

MOST_FRAMES = 1500  # a longer run keeps every second step, then every fourth, ...
MOST_BEAMS = 180  # of a scan that are drawn
CM, MRAD, MM2 = 100.0, 1000.0, 1e6  # lengths, angles and covariances are written in these units
CURVES = (  # metrics that are drawn over time, as far as a run has them, and their factor
    *(("coverage", 1e4), ("correct_coverage", 1e4), ("pose_error_m", 1e4), ("nees", 100.0), ("landmarks", 1.0)),
    *(("rooms_found", 1.0), ("rooms", 1.0), ("doors_found", 1.0), ("doors", 1.0), ("contacts", 1.0)),
)
REWARD = "reward_"
NO_PATH = np.empty((0, 2))  # the page draws the paths from the poses
NO_CELLS: dict[str, Any] = {
    "label": np.empty((0, 0), np.uint8),
    "polygon": np.empty((0, 0), np.bool_),
    "room": np.empty((0, 0), np.int16),
}


@dataclass(slots=True, eq=False)
class Frame:
    """One step: the messages of the estimator, which are immutable, and what is around them."""

    view: SceneView  # without the cells of its grid
    step: int
    seconds: float
    matched: Ints  # (k,) ids of the map polygon that was recognised, as it was then
    grid: PackedGrid
    curves: Mapping[str, float]


@dataclass(slots=True, eq=False)
class Recorder:
    """Keeps the steps of one run; `run` is what the page needs to draw it."""

    period_s: float = 0.4
    frames: list[Frame] = field(default_factory=list)
    every: int = 1
    steps: int = 0
    earned: dict[str, float] = field(default_factory=dict)  # reward by term, of the steps so far
    before: SlamOutput | None = None

    def look(self, view: SceneView, info: Mapping[str, Any] | None = None, seconds: float | None = None) -> None:
        """Keep a step; `info` of the environment has the terms of its reward, `seconds` is its time in a log."""
        for name, value in (info or {}).items():
            if name.startswith(REWARD):
                self.earned[name] = self.earned.get(name, 0.0) + float(value)
        if self.steps % self.every == 0:
            self.frames.append(self._frame(view, self.steps * self.period_s if seconds is None else seconds))
            self._thin()
        self.before = view.slam_output
        self.steps += 1

    def _thin(self) -> None:
        if len(self.frames) > MOST_FRAMES:
            self.frames = self.frames[::2]
            self.every *= 2

    def _frame(self, view: SceneView, seconds: float) -> Frame:
        output, known = view.slam_output, np.empty(0, np.int64)
        if self.before is not None and 0 <= output.associated.known < len(self.before.map_polygons):
            known = self.before.map_polygons[output.associated.known].ids
        last = self.frames[-1] if self.frames else None
        same = last is not None and last.view.slam_output.grid.version == output.grid.version
        grid = last.grid if last is not None and same else PackedGrid.of(codes(output.grid), output.grid.origin)
        curves = {name: float(view.metrics[name]) for name, _ in CURVES if name in view.metrics}
        bare = replace(output, grid=replace(output.grid, **NO_CELLS))
        short = replace(view, path_world=NO_PATH, path_map=NO_PATH, slam_output=bare)
        return Frame(short, self.steps, seconds, known, grid, curves | self.earned)

    def run(self, title: str, result: str = "") -> dict[str, Any]:
        """All that was kept, as plain data. Call it once there is a step."""
        last = self.frames[-1].view
        units = dict(CURVES) | dict.fromkeys(self.earned, 100.0)
        place, size, cells = changed_cells([frame.grid for frame in self.frames], last.slam_output.grid.resolution_m)
        maps, landmarks = Versions(), changed_rows(map(landmark_rows, self.frames))
        return {
            "title": title,
            "result": result,
            "robot_cm": whole(last.robot_radius_m, CM),
            "walls": [whole(ring, CM) for ring in loops(last.segments)],
            "solid": [signed_area(ring) < 0.0 for ring in loops(last.segments)],
            "map_in_world": [*whole(last.T_world_map[:2], CM), whole(last.T_world_map[2], MRAD)],
            "bearings": whole(beams_shown(last.slam_output)[0], MRAD),
            "laser": [*whole(last.slam_output.T_robot_laser[:2], CM), whole(last.slam_output.T_robot_laser[2], MRAD)],
            "grid": {"origin": whole(place, CM), "size": size, "cell": last.slam_output.grid.resolution_m},
            "rooms": [list(colour) for colour in palette.ROOMS],
            "reasons": {int(reason): REASONS[reason] for reason in Reason},
            "kinds": KINDS,
            "decisions": {int(decision): DECISIONS[decision] for decision in Decision},
            "curve_units": units,
            "frames": [
                self._written(frame, maps, runs, rows)
                for frame, runs, rows in zip(self.frames, cells, landmarks, strict=True)
            ],
            "maps": maps.all,
            "opens_at": self._telling(),
        }

    def _telling(self) -> int:
        """The frame to open at: a polygon of the map is recognised, with as many landmarks as ever, half-way or so."""
        count = [len(f.view.slam_output.match.recognised()) if len(f.matched) else 0 for f in self.frames]
        first, last = len(count) // 4, 1 + 3 * len(count) // 4
        return first + int(np.argmax(count[first:last])) if any(count[first:last]) else len(count) // 2

    def _written(self, frame: Frame, maps: Versions, cells: list[int], landmarks: list[list[int]]) -> dict[str, Any]:
        """One step in whole numbers; what did not change is left out."""
        view, output = frame.view, frame.view.slam_output
        units = dict(CURVES) | dict.fromkeys(self.earned, 100.0)
        ranges = beams_shown(output)[1]
        written = {
            "step": frame.step,
            "time": whole(frame.seconds, 100.0),
            "truth": pose(view.T_world_robot) if len(view.segments) else None,
            "pose": pose(output.belief.T_map_robot),
            "cov": whole(upper(output.belief.pose_cov[:2, :2]), MM2),
            "turn_sigma": whole(np.sqrt(output.belief.pose_cov[2, 2]), MRAD),
            "ranges": whole(ranges, CM),
            "corners": corner_rows(output.corners, output.match, output.associated),
            "polygons": [whole(points_of(output)[p.corners], CM) for p in output.polygons],
            "chosen": output.associated.polygon,
            "matched": frame.matched.tolist(),
            "landmarks": landmarks,
            "cells": cells,
            "map": maps.number(map_of(output)),
            "room": output.graph.resolve(output.graph.current),
            "goals": goal_rows(view),
            "target": view.target,
            "moving": [whole(ring, CM) for ring in loops(view.moving)],
            "confidence": whole(output.confidence, MRAD),
            "lost": not output.localised,
            "curves": {name: whole(value, units[name]) for name, value in frame.curves.items()},
        }
        return {name: value for name, value in written.items() if not (value is None or value is False or value == [])}


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


def landmark_rows(frame: Frame) -> dict[int, list[int]]:
    """For each landmark x, y in cm and its covariance xx, xy, yy in mm^2."""
    belief = frame.view.slam_output.belief
    places = whole(belief.p_map, CM)
    covs = whole(upper(belief.covs), MM2)
    return {name: [*p, *c] for name, p, c in zip(belief.ids.tolist(), places, covs, strict=True)}


def map_of(output: SlamOutput) -> dict[str, Any]:
    """Polygons with their rooms, doors by the landmarks of their jambs, and gaps that are no doors yet."""
    graph = output.graph
    pairs = [pair for door in graph.doors for pair in (door.jambs, door.other_face) if pair is not None]
    return {
        "polygons": [[graph.resolve(p.room), *p.ids.tolist()] for p in output.map_polygons],
        "doors": [list(pair) for pair in pairs],
        "gaps": [whole(gap.ends, CM) for gap in graph.candidates],
        "rooms": list(graph.rooms),
    }


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
