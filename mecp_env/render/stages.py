"""One picture per stage of the processing of one scan (docs/one-scan.md), all in the robot's frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from mecp_env.core.carriers import Array
from mecp_env.core.se2 import polar_to_points, to_robot
from mecp_env.render import palette, shapes
from mecp_env.render.figures import drawn
from mecp_env.render.palette import unit
from mecp_env.slam.messages import Clusters, CornerKind, Decision, EdgeLabel, Reason
from mecp_env.slam.output import SlamOutput

KINDS = {CornerKind.CROSSING: ("o", "crossing"), CornerKind.FREE_END: ("s", "free end"), CornerKind.JAMB: ("D", "jamb")}
EDGES = {EdgeLabel.WALL: palette.SOLID, EdgeLabel.GAP: palette.DOOR, EdgeLabel.OPEN: palette.GOAL}
MARKS = {Decision.LANDMARK: "o", Decision.PROVISIONAL: "^", Decision.NEW: "D", Decision.IGNORED: "x"}
DASHES = {EdgeLabel.WALL: "-", EdgeLabel.GAP: (0, (2, 1)), EdgeLabel.OPEN: (0, (5, 2))}
WIDTH_IN = 7.6  # as wide as the text of a page, whose inch has 96 px
DPI = 200
READABLE_PT = 6.0  # size of a mark in a legend


def stage_figures(output: SlamOutput, clusters: Clusters) -> dict[str, Figure]:
    """Figures by name, in the order of the stages: scan, clusters, segments, corners, polygon, association."""
    drawers: dict[str, Callable[[Axes, SlamOutput], None]] = {
        "scan": _draw_scan,
        "clusters": partial(_draw_clusters, clusters),
        "segments": _draw_segments,
        "corners": _draw_corners,
        "polygon": _draw_polygon,
        "association": _draw_association,
    }
    return {name: _figure(draw, output) for name, draw in drawers.items()}


def _figure(draw: Callable[[Axes, SlamOutput], None], output: SlamOutput) -> Figure:
    hits = _hits(output)
    low, high = np.percentile(hits, 3.0, axis=0) - 0.8, np.percentile(hits, 97.0, axis=0) + 0.8
    height = WIDTH_IN * (high[1] - low[1]) / (high[0] - low[0]) + 1.0
    figure = Figure(figsize=(WIDTH_IN, height), layout="constrained")
    axes = figure.add_subplot()
    draw(axes, output)
    axes.plot(0.0, 0.0, marker=(3, 0, -90), color=unit(palette.INK), markersize=11, linestyle="none", label="robot")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set_xlabel("x, m", fontsize=9)
    axes.set_ylabel("y, m", fontsize=9)
    axes.tick_params(labelsize=8, colors=unit(palette.MUTED))
    axes.spines[:].set_visible(False)
    axes.grid(alpha=0.25)
    legend = figure.legend(**drawn(axes), loc="outside lower center", ncols=5, frameon=False, fontsize=9)
    for line in legend.get_lines():
        line.set_markersize(max(line.get_markersize(), READABLE_PT))
    return figure


def _points(output: SlamOutput) -> Array:
    """(B,2) m: the merged beams' ends."""
    return polar_to_points(np.column_stack([output.beams.ranges, output.beams.bearings]))


def _hits(output: SlamOutput) -> Array:
    hits: Array = _points(output)[output.beams.hit]
    return hits


def _draw_scan(axes: Axes, output: SlamOutput) -> None:
    beams = output.beams
    raw = polar_to_points(np.column_stack([beams.raw_ranges, beams.raw_bearings]))
    label = f"{len(raw)} raw beams (dense scan)"
    axes.plot(*raw[beams.raw_ranges < beams.max_range_m].T, ".", color=unit(palette.BEAM), markersize=2, label=label)
    axes.plot(*_hits(output).T, ".", color=unit(palette.HIT), markersize=2.5, label="merged beams")


def _draw_clusters(clusters: Clusters, axes: Axes, output: SlamOutput) -> None:
    points = _points(output)
    for row, (first, last) in enumerate(zip(clusters.first, clusters.last, strict=True)):
        index = (clusters.roll + np.arange(first, last + 1)) % len(points)
        colour, mark = unit(palette.SERIES[row % len(palette.SERIES)]), palette.MARKERS[row % len(palette.MARKERS)]
        axes.plot(*points[index].T, mark, color=colour, markersize=3)
    axes.set_title(f"{len(clusters.first)} clusters, neighbours differ in colour and mark", loc="left", fontsize=10)


def _draw_segments(axes: Axes, output: SlamOutput) -> None:
    points = list(output.segments.points)
    colours = [unit(palette.SERIES[row % len(palette.SERIES)]) for row in range(len(points))]
    grey = unit(palette.mix(palette.FAINT, palette.FREE, 0.4))
    axes.plot(*_hits(output).T, ".", color=grey, markersize=3, label="merged beams")
    axes.add_collection(LineCollection(points, colors=colours, linewidths=2.0))
    ends = np.concatenate([np.empty((0, 2)), *points])
    axes.plot(*ends.T, "|", color=unit(palette.INK), markersize=7, label="end of a line")
    axes.set_title(f"{len(points)} lines fitted", loc="left", fontsize=10)


def _draw_walls(axes: Axes, output: SlamOutput) -> None:
    colour = unit(palette.mix(palette.SOLID, palette.FREE, 0.6))
    axes.add_collection(LineCollection(list(output.segments.points), colors=colour, linewidths=1.5, label="line"))


def _draw_corners(axes: Axes, output: SlamOutput) -> None:
    _draw_walls(axes, output)
    corners = output.corners
    points = polar_to_points(corners.z)
    for kind, (marker, name) in KINDS.items():
        chosen = corners.kind == kind
        axes.plot(*points[chosen].T, marker, color=unit(palette.LANDMARK), fillstyle="none", label=name)
    said = f"95 %, {shapes.ELLIPSE_MAGNIFIED:.0f} times larger"
    rings = [_ring(point, z, cov) for point, z, cov in zip(points, corners.z, corners.R, strict=True)]
    axes.add_collection(LineCollection(rings, colors=unit(palette.LANDMARK), linewidths=0.7, label=said))
    doors = [points[jambs] for jambs in corners.doorways.jambs]
    axes.add_collection(LineCollection(doors, colors=unit(palette.DOOR), linewidths=3.0, label="door"))
    axes.plot(*points[corners.beyond >= 0].T, "x", color=unit(palette.DOOR), label="seen through a door")


def _ring(point: Array, z: Array, cov: Array) -> Array:
    """The 95 % ellipse of a corner given as range and bearing, in the plane."""
    along, across = point / z[0], np.array([-point[1], point[0]])
    J = np.column_stack([along, across])  # d point / d (range, bearing)
    return shapes.closed(shapes.ellipse(point, J @ cov @ J.T, shapes.ELLIPSE_MAGNIFIED))


def _draw_polygon(axes: Axes, output: SlamOutput) -> None:
    _draw_walls(axes, output)
    points = polar_to_points(output.polygon_corners.z)
    sites = output.polygon_corners.sites
    axes.plot(*points[sites].T, "o", color=unit(palette.LANDMARK), label="site: may be a vertex")
    axes.plot(*points[~sites].T, "s", color=unit(palette.FAINT), fillstyle="none", label="no site")
    rings = [points[polygon.corners] for polygon in output.polygons]
    light = unit(palette.mix(palette.ROOMS[0], palette.FREE, 0.85))  # opaque: many are no darker than one
    axes.add_collection(PolyCollection(rings, facecolors=light, edgecolors="none", zorder=0.5, label="polygon"))
    for label in EDGES:
        lines = [
            line
            for ring, one in zip(rings, output.polygons, strict=True)
            for line in _lines(ring, one.intervals, label)
        ]
        looks: dict[str, Any] = {"linewidths": 3.0, "linestyles": [DASHES[label]], "label": label.name.lower()}
        axes.add_collection(LineCollection(lines, colors=unit(EDGES[label]), capstyle="butt", **looks))


def _lines(ring: Array, intervals: Array, label: EdgeLabel) -> Iterator[Array]:
    """The stretches (2,2) m of the edges that have a label."""
    for edge, start, end, kind in intervals:
        if kind == label:
            a, b = ring[int(edge)], ring[(int(edge) + 1) % len(ring)]
            yield np.stack([a + start * (b - a), a + end * (b - a)])


def _draw_association(axes: Axes, output: SlamOutput) -> None:
    _draw_walls(axes, output)
    belief, match = output.belief, output.match
    known = to_robot(output.T_map_laser, np.ascontiguousarray(belief.p_map))
    axes.plot(*known.T, "+", color=unit(palette.LANDMARK), markersize=9, label="landmark of the map")
    points = polar_to_points(output.corners.z)
    for decision, mark in MARKS.items():
        chosen, colour = match.decision == decision, unit(shapes.DECISION_COLOURS[decision])
        axes.plot(*points[chosen].T, mark, color=colour, fillstyle="none", label=decision.name.lower())
    for point, name, reason in zip(points, match.ids, match.reason, strict=True):
        words = f"{name} {Reason(int(reason)).name.lower()}" if name >= 0 else Reason(int(reason)).name.lower()
        axes.annotate(words, point, (5, 5), textcoords="offset points", fontsize=8, annotation_clip=True)
