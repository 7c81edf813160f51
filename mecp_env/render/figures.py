"""The finished map as a figure, with matplotlib."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from numpy.typing import NDArray

from mecp_env.core.se2 import to_map
from mecp_env.core.text import sanitised
from mecp_env.render import palette, shapes
from mecp_env.render.palette import unit
from mecp_env.render.view import SceneView, loops, signed_area, summary

Array = NDArray[np.float64]

ELLIPSE_MAGNIFIED = 5.0
CAPTION_POINTS = 1400.0  # of all letters together: what fits into a line
TRUTH_GREY = (0.72, 0.73, 0.75)


def save(figure: Figure, path: Path, dpi: int = 150) -> None:
    """Write a figure as PNG without the date, so that the same figure gives the same file."""
    with boxes_for_missing_glyphs():
        figure.savefig(path, dpi=dpi, metadata={"Software": None})


@contextmanager
def boxes_for_missing_glyphs() -> Iterator[None]:
    """Names in any script: matplotlib draws a box for what its font has not, and need not warn."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")
        yield


def map_figure(view: SceneView) -> Figure:
    """The map at the end of an episode, laid over the truth (in grey): rooms, doors, landmarks, both paths."""
    width, height = view.bounds[1] - view.bounds[0]
    figure = Figure(figsize=(11.0, 11.0 * height / width + 1.6), layout="constrained")
    axes = figure.add_subplot()
    _draw_truth(axes, view)
    _draw_rooms(axes, view)
    _draw_doors(axes, view)
    axes.plot(*view.path_world.T, color=unit(palette.INK), linewidth=2.2, alpha=0.35)
    axes.plot(*to_map(view.T_world_map, view.path_map).T, color=unit(palette.ESTIMATE), linewidth=0.9)
    _draw_landmarks(axes, view)
    _name_rooms(axes, view)
    _draw_scale(axes, view.bounds)
    _plain(axes, view.bounds)
    caption = sanitised(_caption(view))
    size = min(13.0, max(7.0, CAPTION_POINTS / len(caption)))
    figure.suptitle(caption, x=0.01, ha="left", fontsize=size, parse_math=False)
    figure.legend(handles=_map_legend(view), loc="outside lower left", ncols=7, frameon=False, fontsize=9)
    return figure


def _caption(view: SceneView) -> str:
    return "    ".join([view.title, *(f"{name} {value}" for name, value in summary(view.metrics))])


def _draw_truth(axes: Axes, view: SceneView) -> None:
    """Walls in grey, free space in white; the polygons of the map lie between the two."""
    for strip in shapes.wall_strips(view.segments):
        axes.add_patch(Polygon(strip, facecolor=TRUTH_GREY, edgecolor="none"))
    for ring in loops(view.segments):
        solid = signed_area(ring) < 0.0
        axes.add_patch(Polygon(ring, facecolor=TRUTH_GREY if solid else "white", edgecolor="none"))
    for ring in loops(view.moving):
        axes.add_patch(Polygon(ring, facecolor=unit(palette.MOVER), edgecolor="none", alpha=0.6, zorder=3.0))


def _draw_rooms(axes: Axes, view: SceneView) -> None:
    for polygon, ring in shapes.polygon_rings(view.slam_output):
        colour = palette.room_colour(view.slam_output.graph.resolve(polygon.room))
        light = palette.mix(colour, palette.FREE, 0.75)  # opaque: many polygons of a room are no darker than one
        p_world = to_map(view.T_world_map, ring)
        axes.add_patch(Polygon(p_world, facecolor=unit(light), edgecolor="none"))
        axes.add_patch(Polygon(p_world, fill=False, edgecolor=(*unit(colour), 0.3), linewidth=0.7, zorder=1.5))


def _draw_doors(axes: Axes, view: SceneView) -> None:
    where = shapes.positions(view.slam_output.belief)
    for door in view.slam_output.graph.doors:
        for face in shapes.door_faces(door, where):
            axes.plot(*to_map(view.T_world_map, face).T, color=unit(palette.DOOR), linewidth=3.0)
    for candidate in view.slam_output.graph.candidates:
        ends = to_map(view.T_world_map, candidate.ends)
        axes.plot(*ends.T, color=unit(palette.DOOR), linewidth=1.5, linestyle=":")


def _draw_landmarks(axes: Axes, view: SceneView) -> None:
    belief = view.slam_output.belief
    for mean, cov in zip(belief.p_map, belief.covs, strict=True):
        ring = to_map(view.T_world_map, shapes.ellipse(mean, cov, ELLIPSE_MAGNIFIED))
        axes.add_patch(Polygon(ring, fill=False, edgecolor=unit(palette.LANDMARK), linewidth=0.8))
    axes.plot(*to_map(view.T_world_map, belief.p_map).T, "+", color=unit(palette.LANDMARK), markersize=5)


def _name_rooms(axes: Axes, view: SceneView) -> None:
    for room, p_map in shapes.room_labels(view.slam_output).items():
        x, y = to_map(view.T_world_map, p_map[None])[0]
        colour = unit(palette.mix(palette.room_colour(room), palette.INK, 0.4))
        axes.text(x, y, f"room {room}", ha="center", va="center", color=colour, fontsize=11, fontweight="bold")


def _draw_scale(axes: Axes, bounds: Array) -> None:
    """A bar of two metres below the building's right corner."""
    right, y = bounds[1, 0], bounds[0, 1] - 0.45
    axes.plot([right - 2.0, right], [y, y], color=unit(palette.INK), linewidth=2.5, solid_capstyle="butt")
    axes.text(right - 1.0, y - 0.1, "2 m", ha="center", va="top", fontsize=9)


def _plain(axes: Axes, bounds: Array) -> None:
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_xlim(bounds[0, 0] - 0.5, bounds[1, 0] + 0.5)
    axes.set_ylim(bounds[0, 1] - 1.0, bounds[1, 1] + 0.5)


def _map_legend(view: SceneView) -> list[Patch | Line2D]:
    ink, blue, red, amber = (unit(c) for c in (palette.INK, palette.ESTIMATE, palette.LANDMARK, palette.DOOR))
    room = unit(palette.ROOMS[0])
    movers = [Patch(color=unit(palette.MOVER), alpha=0.6, label="pedestrian, box")] if len(view.moving) else []
    return [
        Patch(color=TRUTH_GREY, label="true walls"),
        Line2D([], [], color=ink, alpha=0.35, linewidth=2.2, label="true path"),
        Line2D([], [], color=blue, label="estimated path"),
        Line2D([], [], color=red, marker="+", linestyle="none", label="landmark"),
        Line2D([], [], color=red, marker="o", fillstyle="none", linestyle="none", label=_ellipse_label()),
        Patch(facecolor=(*room, 0.2), edgecolor=room, label="polygons of a room"),
        Line2D([], [], color=amber, linewidth=3, label="door"),
        *movers,
    ]


def _ellipse_label() -> str:
    return f"95 % ellipse, drawn {ELLIPSE_MAGNIFIED:.0f} times larger"
