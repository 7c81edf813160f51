"""The finished map as a figure, and a run over time: pose error and 3 sigma, NEES, coverage, landmarks.

Legends that name what is drawn, and nothing else.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import Collection, LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from mecp_env.core.carriers import Array
from mecp_env.core.files import sanitised
from mecp_env.render import palette, shapes
from mecp_env.render.palette import unit
from mecp_env.render.shapes import SceneView, loops, signed_area, summary

DPI = 220  # a figure has at least twice the pixels of the place where a page shows it
CAPTION_POINTS = 1400.0  # of all letters together: what fits into a line
BARS_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
ASIDE_M, BELOW_M = 0.5, 1.0  # around the building: the scale bar is below it
TRUTH_GREY = (0.72, 0.73, 0.75)
TRUE_PATH = palette.mix(palette.INK, palette.FREE, 0.55)
NEES_BAND = 0.216, 9.348  # 95 % of a chi-square of 3 degrees of freedom
LEAST_NEES, MOST_NEES = 0.02, 30.0  # of the axis, which a larger value makes longer
NEES, COUNTS = "NEES, no unit", "on the map, count"
Moment = Mapping[str, float]
Line = tuple[str, str, palette.RGB, float]  # metric, its name, colour, factor
PANELS: dict[str, tuple[Line, ...]] = {  # the label of the y axis, and what is over time
    "position, cm": (("pose_error_m", "error", palette.HIT, 100.0), ("sigma3_m", "3 sigma", palette.FAINT, 100.0)),
    NEES: (("nees", "NEES of the pose, 3 expected", palette.ESTIMATE, 1.0),),
    "floor, %": (
        ("correct_coverage", "correct coverage", palette.GOAL, 100.0),
        ("coverage", "coverage", palette.FAINT, 100.0),
    ),
    COUNTS: (
        ("landmarks", "landmarks", palette.LANDMARK, 1.0),
        ("doors_found", "doors found", palette.DOOR, 1.0),
        ("rooms_found", "rooms found", palette.ESTIMATE, 1.0),
    ),
}
DASHES = ("-", "--", ":")


def drawn(axes: Axes) -> dict[str, Any]:
    """`handles` and `labels` for a legend, of the artists that show something."""
    pairs = zip(*axes.get_legend_handles_labels(), strict=True)
    shown = [(artist, label) for artist, label in pairs if is_drawn(artist)]
    return {"handles": [artist for artist, _ in shown], "labels": [label for _, label in shown]}


def is_drawn(artist: Artist | Any) -> bool:
    """Whether an artist shows something: a line without a finite point shows nothing, a collection without a path."""
    if isinstance(artist, Line2D):
        return bool(np.isfinite(np.asarray(artist.get_xydata(), float)).all(axis=1).any())
    return len(artist.get_paths()) > 0 if isinstance(artist, Collection) else True


def open_axes(axes: Axes) -> None:
    """A light grid, and no frame at the top and at the right."""
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)


def save(figure: Figure, path: Path, dpi: int = DPI) -> None:
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
    """The map at the end of an episode: rooms, doors, landmarks, both paths, over the truth or the mapped walls."""
    width, height = view.bounds[1] - view.bounds[0]
    figure = Figure(
        figsize=(11.0, 11.0 * (height + BELOW_M + ASIDE_M) / (width + 2.0 * ASIDE_M) + 0.9), layout="constrained"
    )
    axes = figure.add_subplot()
    known = len(view.segments) > 0
    (_draw_truth if known else _draw_mapped_walls)(axes, view)
    _draw_rooms(axes, view)
    _draw_doors(axes, view)
    path = "true path" if known else "reference path"
    axes.plot(*view.path_world.T, color=unit(TRUE_PATH), linewidth=4.0, label=path)
    estimated = view.to_world(view.path_map).T
    axes.plot(*estimated, color=unit(palette.ESTIMATE), linewidth=1.1, label="estimated path")
    _draw_landmarks(axes, view)
    _name_rooms(axes, view)
    _draw_scale(axes, view.bounds)
    _plain(axes, view.bounds)
    caption = sanitised("    ".join([view.title, *(f"{name} {value}" for name, value in summary(view.metrics))]))
    size = min(13.0, max(7.0, CAPTION_POINTS / len(caption)))
    figure.suptitle(caption, x=0.01, ha="left", fontsize=size, parse_math=False)
    figure.legend(**drawn(axes), loc="outside lower left", ncols=8, frameon=False, fontsize=9, columnspacing=1.5)
    return figure


def _draw_truth(axes: Axes, view: SceneView) -> None:
    """Walls in grey, free space in white; the polygons of the map lie between the two."""
    rings = loops(view.segments)
    inside = [TRUTH_GREY if signed_area(ring) < 0.0 else (1.0, 1.0, 1.0) for ring in rings]
    strips = list(shapes.wall_strips(view.segments))
    axes.add_collection(PolyCollection(strips, facecolors=TRUTH_GREY, label="true walls"))
    axes.add_collection(PolyCollection(rings, facecolors=inside))
    if len(view.moving):
        looks: dict[str, Any] = {"facecolors": unit(palette.MOVER), "alpha": 0.6, "zorder": 3.0}
        axes.add_collection(PolyCollection(loops(view.moving), label="pedestrian, box", **looks))


def _draw_mapped_walls(axes: Axes, view: SceneView) -> None:
    """The semantic grid: walls dark, one colour per room."""
    grid = view.slam_output.grid
    (x, y), (height, width) = grid.origin.tolist(), grid.label.shape
    columns, rows = x + grid.resolution_m * np.arange(width + 1), y + grid.resolution_m * np.arange(height + 1)
    looks: dict[str, Any] = {"linewidth": 0.0, "antialiased": False, "rasterized": True, "zorder": 0.5}
    axes.pcolormesh(columns, rows, shapes.cell_colours(grid), **looks)  # an image would take 300 MB while it is drawn


def _draw_rooms(axes: Axes, view: SceneView) -> None:
    known = shapes.polygon_rings(view)
    rings = [ring for ring, _ in known]
    light = [unit(palette.mix(colour, palette.FREE, 0.75)) for _, colour in known]  # many are no darker than one
    edges = [unit(palette.mix(colour, palette.FREE, 0.45)) for _, colour in known]
    axes.add_collection(
        PolyCollection(rings, facecolors=light, edgecolors=edges, zorder=1.2, label="polygons of a room")
    )
    looks: dict[str, Any] = {"facecolors": "none", "edgecolors": edges, "linewidths": 0.7, "zorder": 1.5}
    axes.add_collection(PolyCollection(rings, **looks))


def _draw_doors(axes: Axes, view: SceneView) -> None:
    faces, candidates = shapes.door_lines(view)
    colour = unit(palette.DOOR)
    axes.add_collection(LineCollection(faces, colors=colour, linewidths=3.0, label="door"))
    dotted: dict[str, Any] = {"linewidths": 1.5, "linestyles": ":", "label": "door candidate"}
    axes.add_collection(LineCollection(candidates, colors=colour, **dotted))


def _draw_landmarks(axes: Axes, view: SceneView) -> None:
    colour, said = unit(palette.LANDMARK), f"95 % ellipse x {shapes.magnification(view.slam_output.belief):.0f}"
    p_world = view.to_world(view.slam_output.belief.p_map)
    axes.plot(*p_world.T, "+", color=colour, markersize=5, label="landmark")
    looks: dict[str, Any] = {"facecolors": "none", "edgecolors": colour, "linewidths": 0.8, "zorder": 2.0}
    axes.add_collection(PolyCollection(shapes.landmark_ellipses(view), label=said, **looks))


def _name_rooms(axes: Axes, view: SceneView) -> None:
    for room, p_map in shapes.room_labels(view.slam_output, view.path_map).items():
        x, y = view.to_world(p_map[None])[0]
        colour = unit(palette.mix(palette.room_colour(room), palette.INK, 0.4))
        name = axes.text(x, y, f"room {room}", ha="center", va="center", color=colour, fontsize=11, fontweight="bold")
        name.set_path_effects([withStroke(linewidth=3.0, foreground="white")])


def _draw_scale(axes: Axes, bounds: Array) -> None:
    """A bar below the building's right corner, at most a quarter of it long."""
    length = max((bar for bar in BARS_M if bar <= (bounds[1, 0] - bounds[0, 0]) / 4.5), default=BARS_M[0])
    right, y = bounds[1, 0], bounds[0, 1] - 0.45
    axes.plot([right - length, right], [y, y], color=unit(palette.INK), linewidth=2.5, solid_capstyle="butt")
    axes.text(right - 0.5 * length, y - 0.1, f"{length:g} m", ha="center", va="top", fontsize=9)


def _plain(axes: Axes, bounds: Array) -> None:
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_xlim(bounds[0, 0] - ASIDE_M, bounds[1, 0] + ASIDE_M)
    axes.set_ylim(bounds[0, 1] - BELOW_M, bounds[1, 1] + ASIDE_M)


def moment_of(view: SceneView) -> Moment:
    """What the curves show of one step: the metrics, and 3 sigma of the position (m) along its longer axis."""
    cov = view.slam_output.belief.pose_cov[:2, :2]
    return {**view.metrics, "sigma3_m": 3.0 * math.sqrt(max(float(np.linalg.eigvalsh(cov)[-1]), 0.0))}


def curves_figure(title: str, period_s: float, moments: Sequence[Moment]) -> Figure:
    """The curves of a run whose steps are `period_s` apart, from the first one on."""
    figure = Figure(figsize=(11.0, 6.0), layout="constrained")
    t = period_s * np.arange(len(moments))
    for axes, (label, lines) in zip(figure.subplots(2, 2, sharex=True).ravel(), PANELS.items(), strict=True):
        for (name, words, colour, factor), dashes in zip(lines, DASHES, strict=False):
            values = factor * np.array([moment.get(name, math.nan) for moment in moments], float)
            axes.plot(t, values, dashes, color=unit(colour), lw=1.3, label=words)
        if label == NEES:
            _draw_band(axes)
        if label == COUNTS:
            axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        _dress(axes, label)
    figure.suptitle(sanitised(title), x=0.01, ha="left", fontsize=12, parse_math=False)
    return figure


def _draw_band(axes: Axes) -> None:
    values = np.asarray(axes.lines[0].get_ydata(), float)
    axes.set_yscale("log", nonpositive="clip")
    axes.set_ylim(LEAST_NEES, max([MOST_NEES, *values[np.isfinite(values)]]))
    axes.yaxis.set_major_formatter("{x:g}")
    if is_drawn(axes.lines[0]):
        axes.axhspan(*NEES_BAND, color=unit(palette.BEAM), alpha=0.25, lw=0, label="95 % of a consistent filter")


def _dress(axes: Axes, label: str) -> None:
    axes.set_ylabel(label, fontsize=9)
    axes.set_xlabel("time, s", fontsize=9)
    open_axes(axes)
    axes.tick_params(labelsize=8)
    names = drawn(axes)
    if names["handles"]:
        axes.legend(**names, frameon=False, fontsize=8)
