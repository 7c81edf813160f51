"""A run as a recording of the rerun viewer: one .rrd file that its window scrubs (docs/replay.md).

The extra `viewer` installs rerun. Entities below `belief` are in the map frame, those below `world` in the true one;
lengths in metres, the robot's plane is z = 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.errors import ConfigError
from mecp_env.core.se2 import polar_to_points, to_map
from mecp_env.render import palette, shapes
from mecp_env.render.replay import DECISIONS, KINDS, REASONS, REWARD, earned
from mecp_env.render.shapes import SceneView
from mecp_env.slam.messages import LANDMARK, Decision, Match, Reason, SemanticGrid
from mecp_env.slam.output import SlamOutput

INSTALL = "install the extra `viewer`: pip install 'mecp_env[viewer]'"
PANELS: Mapping[str, tuple[str, tuple[str, ...]]] = {  # panel -> title, and metrics that are drawn over time in it
    "error": ("Pose error and 3 sigma, m", ("pose_error_m",)),
    "nees": ("NEES", ("nees",)),
    "share": ("Coverage and confidence", ("coverage", "correct_coverage")),
    "count": ("Found", ("landmarks", "rooms_found", "doors_found", "contacts")),
    "reward": ("Reward, summed", ()),
}
HEIGHTS = {"grid": -0.02, "lines": 0.0, "points": 0.02}  # m, so that points are drawn above lines
THIN_M, THICK_M = 0.015, 0.04  # radii of lines
DOT_M = 0.05
SEEN_FROM, LEAST_HEIGHT_M = 1.1, 12.0  # the first view is from so many times the size of the building above it
PATH = "belief/path"  # a piece a step; the first view shows all up to the present


def rerun_library() -> Any:
    """The module `rerun`. Raises `ConfigError` where it is not installed."""
    try:
        return import_module("rerun")
    except ImportError:
        raise ConfigError(f"the library rerun is not installed; {INSTALL}") from None


class RerunLog:
    """Writes the steps of one run to `path` as they come; `close` ends the file.

    Each step is at its number on the timeline `step`, and at its seconds on the timeline `time`. Raises `ConfigError`
    without rerun, and `OSError` where the file cannot be written.
    """

    def __init__(self, path: str | Path, period_s: float = 0.4) -> None:
        self.rr = rerun_library()
        self.period_s, self.steps = period_s, 0
        self.earned: dict[str, float] = {}  # reward by term, of the steps so far
        self.grid_version = -1  # of the grid that was logged last
        self.last_place: Array | None = None
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.open("wb").close()  # rerun itself says nothing where it cannot write
        self.path, self.stream = path, self.rr.RecordingStream("mecp_env")

    def look(self, view: SceneView, info: Mapping[str, Any] | None = None, seconds: float | None = None) -> None:
        """Log a step; `info` of the environment has the terms of its reward, `seconds` is its time in a log."""
        if not self.steps:
            self.stream.save(self.path, default_blueprint=_first_view(view.bounds))
            self._world(view)
        self.stream.set_time("step", sequence=self.steps)
        self.stream.set_time("time", duration=self.steps * self.period_s if seconds is None else seconds)
        self._robot(view)
        self._scan(view.slam_output)
        self._map(view)
        self._goals(view)
        self._curves(view, info or {})
        self._words(view.slam_output)
        self.steps += 1

    def close(self) -> None:
        """Write what is still held back."""
        self.stream.flush()
        self.stream.disconnect()

    def _world(self, view: SceneView) -> None:
        """What does not change: the walls, and where the map frame lies."""
        self.stream.log("/", self.rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self.stream.log("belief", self._transform(view.T_world_map), static=True)
        self._lines("world/walls", map(shapes.closed, shapes.loops(view.segments)), palette.SOLID, static=True)

    def _robot(self, view: SceneView) -> None:
        """The believed pose with its 95 % ellipse and, where there is truth, the true one with what moves."""
        output, log = view.slam_output, self.stream.log
        pose = output.belief.T_map_robot
        body = _circle(view.robot_radius_m)
        log("belief/robot", self._transform(pose))
        self._lines("belief/robot/body", [body], palette.ESTIMATE, THICK_M)
        log("belief/robot/laser", self._transform(output.T_robot_laser))
        ellipse = shapes.ellipse(pose[:2], output.belief.pose_cov[:2, :2])
        self._lines("belief/pose_ellipse", [shapes.closed(ellipse)], palette.LANDMARK)
        if self.last_place is not None:
            self._lines(PATH, [np.array([self.last_place, pose[:2]])], palette.ESTIMATE)
        self.last_place = pose[:2]
        if len(view.segments):
            log("world/robot", self._transform(view.T_world_robot))
            self._lines("world/robot/body", [body], palette.TRUTH, THICK_M)
            self._lines("world/moving", map(shapes.closed, shapes.loops(view.moving)), palette.MOVER)

    def _scan(self, output: SlamOutput) -> None:
        """Beams, corners with decision and reason, and polygons of this scan, in the laser's frame."""
        at, beams, match = "belief/robot/laser", output.beams, output.match
        hits = polar_to_points(np.column_stack([beams.ranges, beams.bearings])[beams.hit])
        self._points(f"{at}/scan", hits, palette.HIT, 0.02)
        corners = polar_to_points(output.corners.z)
        colours = [shapes.DECISION_COLOURS[Decision(one)] for one in match.decision.tolist()]
        self._points(f"{at}/corners", corners, colours, DOT_M, _reasons(match))
        vertices = polar_to_points(output.polygon_corners.z)
        rings = [shapes.closed(vertices[polygon.corners]) for polygon in output.polygons]
        self._lines(f"{at}/polygons", rings, palette.FAINT)
        known = 0 <= match.polygon < len(rings)
        self._lines(f"{at}/recognised_polygon", [rings[match.polygon]] if known else [], palette.POLYGON, THICK_M)
        self._lines("belief/matches", _pairs(output, corners), palette.GOAL)

    def _map(self, view: SceneView) -> None:
        """Grid, landmarks with ellipses, polygons and doors of the map, as far as its landmarks are in the filter."""
        output, belief = view.slam_output, view.slam_output.belief
        believed = replace(view, T_world_map=np.zeros(3))  # in the map frame
        if self.grid_version != output.grid.version:
            self.grid_version = output.grid.version
            self.stream.log("belief/grid", self._grid(output.grid))
        names = [str(name) for name in belief.ids.tolist()]
        self._points("belief/landmarks", belief.p_map, palette.LANDMARK, DOT_M, names)
        ellipses = shapes.landmark_ellipses(believed)
        self._lines("belief/landmark_ellipses", map(shapes.closed, ellipses), palette.LANDMARK)
        polygons = shapes.polygon_rings(believed)
        rings, colours = [shapes.closed(ring) for ring, _ in polygons], [colour for _, colour in polygons]
        self._lines("belief/map_polygons", rings, colours)
        faces, gaps = shapes.door_lines(believed)
        self._lines("belief/doors", faces, palette.DOOR, THICK_M)
        self._lines("belief/gaps", gaps, palette.DOOR)

    def _goals(self, view: SceneView) -> None:
        """Goals with their figures, and the one that the robot drives to."""
        labels = [
            ", ".join([KINDS[kind], *(f"{name} {values[row]:.2f}" for name, values in view.goal_figures.items())])
            for row, kind in enumerate(view.goal_kinds.tolist())
        ]
        self._points("belief/goals", view.p_goals, palette.PLACE, DOT_M, labels)
        self._points("belief/target", view.p_goals[view.target : view.target + 1], palette.GOAL, 2.0 * DOT_M)

    def _curves(self, view: SceneView, info: Mapping[str, Any]) -> None:
        """Scalars: what the replay draws over time."""
        self.earned |= earned(self.earned, info)
        belief, curves = view.slam_output.belief, dict[str, float]()
        for panel, (_, names) in PANELS.items():
            curves |= {f"{panel}/{name}": view.metrics[name] for name in names if name in view.metrics}
        curves["error/three_sigma_m"] = 3.0 * float(np.sqrt(belief.pose_cov[:2, :2].trace()))
        curves["share/confidence"] = view.slam_output.confidence
        curves |= {f"reward/{name.removeprefix(REWARD)}": value for name, value in self.earned.items()}
        for name, value in curves.items():
            if np.isfinite(value):
                self.stream.log(f"curves/{name}", self.rr.Scalars(float(value)))

    def _words(self, output: SlamOutput) -> None:
        """A line of text: what was recognised and decided, and whether the robot knows where it is."""
        match, counts = output.match, np.bincount(output.match.decision, minlength=len(Decision)).tolist()
        decided = [f"{count} {DECISIONS[Decision(number)]}" for number, count in enumerate(counts) if count]
        said = [] if output.localised else ["the pose is searched for"]
        if 0 <= match.polygon < len(output.polygons):
            said.append(f"polygon of {len(output.polygons[match.polygon].corners)} vertices recognised")
        said.append(f"corners: {', '.join(decided) or 'none'}")
        said.append(f"ellipses of landmarks x {shapes.magnification(output.belief):.0f}")
        self.stream.log("decisions", self.rr.TextLog("; ".join(said), level="INFO" if output.localised else "WARN"))

    def _grid(self, grid: SemanticGrid) -> Any:
        """The semantic grid in colours; its first row of an image is the last of the grid."""
        colours = np.ascontiguousarray(np.flipud(shapes.cell_colours(grid)))
        height, width, _ = colours.shape
        shape = self.rr.components.ImageFormat(width, height, color_model="RGB", channel_datatype="U8")
        place = [*grid.origin.tolist(), HEIGHTS["grid"]]
        return self.rr.GridMap(data=colours.tobytes(), format=shape, cell_size=grid.resolution_m, translation=place)

    def _transform(self, T: Array) -> Any:
        """A pose (3,) of the plane."""
        turn = self.rr.RotationAxisAngle([0, 0, 1], radians=float(T[2]))
        return self.rr.Transform3D(translation=[float(T[0]), float(T[1]), 0.0], rotation=turn)

    def _lines(self, name: str, lines: Iterable[Array], colours: Any, radius: float = THIN_M, **options: Any) -> None:
        strips = [_lifted(line, HEIGHTS["lines"]) for line in lines]
        self.stream.log(name, self.rr.LineStrips3D(strips, colors=colours, radii=radius), **options)

    def _points(self, name: str, points: Array, colours: Any, radius: float, labels: list[str] | None = None) -> None:
        lifted = _lifted(points, HEIGHTS["points"])
        shown = self.rr.Points3D(lifted, colors=colours, radii=radius, labels=labels, show_labels=False)
        self.stream.log(name, shown)


def _first_view(bounds: Array) -> Any:
    """How the window is arranged at first: the plan (2,2) from above, beside it curves and text."""
    views = import_module("rerun.blueprint")
    curves = [views.TimeSeriesView(origin=f"curves/{name}", name=title) for name, (title, _) in PANELS.items()]
    so_far = views.VisibleTimeRange(
        "time", start=views.TimeRangeBoundary.infinite(), end=views.TimeRangeBoundary.cursor_relative()
    )
    middle = bounds.mean(axis=0).tolist()
    above_m = max(SEEN_FROM * float(np.ptp(bounds, axis=0).max()), LEAST_HEIGHT_M)
    eye = views.EyeControls3D(
        kind=views.Eye3DKind.Orbital,
        position=[middle[0], middle[1] - 0.01, above_m],  # rerun cannot look straight down
        look_target=[*middle, 0.0],
        eye_up=[0.0, 0.0, 1.0],
    )
    plan = views.Spatial3DView(
        contents=["world/**", "belief/**"],
        name="World and belief",
        background=views.Background(palette.UNSEEN),
        line_grid=False,
        eye_controls=eye,
        overrides={PATH: views.VisibleTimeRanges(so_far)},
    )
    right = views.Vertical(*curves, views.TextLogView(origin="decisions", name="Decisions"))
    layout = views.Horizontal(plan, right, column_shares=[3, 2])
    time = views.TimePanel(timeline="time", state="collapsed")
    return views.Blueprint(layout, time, collapse_panels=True)


def _reasons(match: Match) -> list[str]:
    """For each corner the decision and its reason in words."""
    rows = zip(match.decision.tolist(), match.reason.tolist(), match.ids.tolist(), match.nis.tolist(), strict=True)
    return [
        f"{DECISIONS[Decision(decision)]}{f' {name}' if name >= 0 else ''}: {REASONS[Reason(reason)]}"
        + (f", NIS {nis:.1f}" if np.isfinite(nis) else "")
        for decision, reason, name, nis in rows
    ]


def _pairs(output: SlamOutput, corners: Array) -> list[Array]:
    """Lines (2,2) m, map frame, from each recognised corner to its landmark."""
    where, seen = shapes.positions(output.belief), to_map(output.T_map_laser, corners)
    pairs = zip(seen, output.match.decision.tolist(), output.match.ids.tolist(), strict=True)
    return [np.array([p, where[name]]) for p, decision, name in pairs if decision == LANDMARK and name in where]


def _circle(radius_m: float) -> Array:
    """(34,2) the outline of the robot and a line to its front."""
    angle = np.linspace(0.0, 2.0 * np.pi, 33)
    ring = radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
    outline: Array = np.vstack([np.zeros(2), ring])
    return outline


def _lifted(points: Array, height_m: float) -> Array:
    """Points (n,2) as (n,3) at a height."""
    lifted: Array = np.column_stack([points, np.full(len(points), height_m)])
    return lifted
