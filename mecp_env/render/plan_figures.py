"""Floor plans with matplotlib: one building, or several on a sheet. The same plans give the same file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, PathPatch, Polygon
from matplotlib.path import Path
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar  # type: ignore[import-untyped]

from mecp_env.core.carriers import Array
from mecp_env.core.errors import ConfigError
from mecp_env.core.files import sanitised
from mecp_env.render import palette
from mecp_env.render.figures import boxes_for_missing_glyphs, save
from mecp_env.render.palette import LINES, FloorPlan, PlanRoom, Shape, unit

FORMATS = (".png", ".svg")
ALONE_IN, ON_SHEET_IN = (7.1, 6.2), (3.5, 3.4)  # width and height that a plan may have, inches
LEAST_IN = 5.2  # width of the drawing of one building, so that its title fits
MARGIN_IN, HEAD_IN, FOOT_IN = 0.3, 0.85, 0.4  # beside a plan, above and below it, for the legend
MOST_ON_SHEET, TWO_COLUMNS = 100, 8  # plans on a sheet; up to so many it is as wide as a column of text
LARGEST_PT, SMALLEST_PT = 11.0, 6.0  # of a room's name; 6 pt are 8 px on a page, whose inch has 96
DPI = 200  # twice that of a page
POINTS_PER_INCH = 72.0
WOOD: palette.RGB = (212, 200, 184)
WOOD_EDGE = unit(palette.mix(WOOD, palette.INK, 0.45))
BARS_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0)


def check_format(path: FilePath) -> FilePath:
    """`path` itself. Raises `ConfigError` when its ending is that of no picture that can be drawn."""
    if path.suffix.lower() not in FORMATS:
        raise ConfigError(f"out: {path}: a picture ends in {' or '.join(FORMATS)}, given {path.suffix!r}")
    return path


def check_count(count: int) -> None:
    """Raise `ConfigError` when so many buildings cannot be drawn on a sheet."""
    if not 1 <= count <= MOST_ON_SHEET:
        raise ConfigError(f"{count} buildings cannot be drawn on one sheet, from 1 to {MOST_ON_SHEET} can")


def save_plans(plans: Sequence[FloorPlan], path: FilePath, dpi: int = DPI) -> None:
    """Draw plans and write them as PNG or SVG, by the ending of `path`; without date."""
    check_format(path)
    with boxes_for_missing_glyphs():
        save(plans_figure(plans), path, dpi)


def plans_figure(plans: Sequence[FloorPlan]) -> Figure:
    """One plan, or several in rows. Raises `ConfigError` for none, or more than fit on a sheet."""
    check_count(len(plans))
    columns, width, heights = _sheet(plans)
    figure = Figure((columns * (width + MARGIN_IN), sum(heights) + FOOT_IN), facecolor="white")
    figure.set_layout_engine(ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.1))
    places = figure.subplots(len(heights), columns, squeeze=False, height_ratios=heights).ravel()
    for axes, plan in zip(places, plans, strict=False):
        _draw_plan(axes, plan, *((13.0, 8.5) if len(plans) == 1 else (9.5, 6.5)))
    for axes in places[len(plans) :]:
        axes.remove()
    figure.legend(handles=_legend(plans), loc="outside lower left", ncols=4, frameon=False, fontsize=7.5)
    figure.draw_without_rendering()  # now the scale of each plan is known
    for axes, plan in zip(places, plans, strict=False):
        left, right = axes.transData.transform([(0.0, 0.0), (1.0, 0.0)])
        for room in plan.rooms:
            _name_room(axes, room, POINTS_PER_INCH / figure.dpi * float(right[0] - left[0]))
    return figure


def _sheet(plans: Sequence[FloorPlan]) -> tuple[int, float, list[float]]:
    """Columns of a sheet, the width of a plan in them, and the height of each row, inches."""
    if len(plans) == 1:
        width, height = _snug(plans[0], ALONE_IN)
        return 1, max(width, LEAST_IN), [height + HEAD_IN]
    columns = 2 if len(plans) <= TWO_COLUMNS else math.ceil(math.sqrt(len(plans)))
    rows = [plans[first : first + columns] for first in range(0, len(plans), columns)]
    return columns, ON_SHEET_IN[0], [HEAD_IN + max(_snug(plan, ON_SHEET_IN)[1] for plan in row) for row in rows]


def _snug(plan: FloorPlan, most: tuple[float, float]) -> tuple[float, float]:
    """Width and height of a plan that is as large as there is space, inches."""
    width, height = plan.bounds[1] - plan.bounds[0]
    scale = min(most[0] / width, most[1] / height)
    return scale * width, scale * height


def _draw_plan(axes: Axes, plan: FloorPlan, big: float, small: float) -> None:
    """Floors, furniture, walls over both, gaps of doors over the walls, starts, scale bar and title."""
    axes.set_axis_off()
    axes.set_aspect("equal", anchor="NW")
    axes.set_xlim(*plan.bounds[:, 0])
    axes.set_ylim(*plan.bounds[:, 1])
    for room in plan.rooms:
        light = palette.mix(palette.ROOMS[room.colour % len(palette.ROOMS)], palette.FREE, 0.74)
        axes.add_patch(Polygon(room.ring, facecolor=unit(light), edgecolor="none"))
    for ring in plan.obstacles:
        axes.add_patch(Polygon(ring, facecolor=unit(WOOD), edgecolor=WOOD_EDGE, linewidth=0.6))
    for shape in plan.walls:
        axes.add_patch(PathPatch(_path(shape), facecolor=unit(palette.SOLID), edgecolor="none"))
    for gap in plan.doors:
        _draw_door(axes, gap)
    for index, start in enumerate(plan.starts):
        _draw_start(axes, start, first=index == 0)
    _draw_bar(axes, plan.bounds)
    name = axes.set_title(sanitised(plan.name), loc="left", fontsize=big, fontweight="bold", pad=2.2 * small)
    name.set(color=unit(palette.INK), parse_math=False)
    grey = unit(palette.MUTED)
    above = axes.annotate(plan.summary, (0, 1), (0, 0.8 * small), xycoords="axes fraction", textcoords="offset points")
    above.set(color=grey, fontsize=small)


def _draw_door(axes: Axes, gap: Array) -> None:
    """The floor continues through the wall; a line in amber is the threshold."""
    axes.add_patch(Polygon(gap, facecolor="white", edgecolor="white", linewidth=0.5))
    ends = np.stack([gap[:2].mean(axis=0), gap[2:].mean(axis=0)])
    axes.plot(*ends.T, color=unit(palette.DOOR), linewidth=2.0, solid_capstyle="butt")


def _draw_start(axes: Axes, start: Array, first: bool) -> None:
    """A disc of the robot's size with its nose; the first one is filled."""
    x, y, heading = start
    blue, radius = unit(palette.ESTIMATE), 0.22
    axes.add_patch(Circle((x, y), radius, facecolor=blue if first else "white", edgecolor=blue, linewidth=0.9))
    nose = np.array([[x, y], [x + radius * math.cos(heading), y + radius * math.sin(heading)]])
    axes.plot(*nose.T, color="white" if first else blue, linewidth=1.0)


def _name_room(axes: Axes, room: PlanRoom, points_per_m: float) -> None:
    """Name and area, as large as there is space; nothing where it could not be read."""
    fitting = points_per_m * room.label_height_m / LINES
    if fitting < SMALLEST_PT:
        return
    size = min(fitting, LARGEST_PT)
    ink = unit(palette.mix(palette.ROOMS[room.colour % len(palette.ROOMS)], palette.INK, 0.6))
    angle = math.radians(room.label_turn_deg)
    up = np.array([-math.sin(angle), math.cos(angle)])
    for words, lift, points in (
        (sanitised(room.name), 0.55, size),
        (f"{room.area_m2:.1f} m²", -0.55, max(0.75 * size, SMALLEST_PT)),
    ):
        dx, dy = lift * size * up
        text = axes.annotate(words, room.label, (dx, dy), textcoords="offset points", fontsize=points, color=ink)
        text.set(ha="center", va="center_baseline", rotation=room.label_turn_deg, rotation_mode="anchor")
        text.set(parse_math=False, in_layout=False)


def _draw_bar(axes: Axes, bounds: Array) -> None:
    """A scale bar below the plan's right corner, about a quarter of it long."""
    length = max((bar for bar in BARS_M if bar <= (bounds[1, 0] - bounds[0, 0]) / 3.0), default=BARS_M[0])
    looks = {"frameon": False, "size_vertical": 0.015 * length, "color": unit(palette.INK), "pad": 0.6}
    place = {"bbox_to_anchor": (1.0, 0.0), "bbox_transform": axes.transAxes, "borderpad": 0.0}
    small = FontProperties(size=7.5)
    bar = AnchoredSizeBar(
        axes.transData, length, f"{length:g} m", "upper right", **looks, **place, fontproperties=small
    )
    axes.add_artist(bar)


def _legend(plans: Sequence[FloorPlan]) -> list[Patch | Line2D]:
    """Entries for what the plans have."""
    blue = unit(palette.ESTIMATE)
    looks: dict[str, Any] = {"marker": "o", "markeredgecolor": blue, "markersize": 7, "linestyle": "none"}
    most_starts = max(len(plan.starts) for plan in plans)
    entries = (
        (any(len(plan.doors) for plan in plans), Line2D([], [], color=unit(palette.DOOR), linewidth=2.0, label="door")),
        (
            any(len(plan.obstacles) for plan in plans),
            Patch(facecolor=unit(WOOD), edgecolor=WOOD_EDGE, label="obstacle"),
        ),
        (most_starts > 0, Line2D([], [], color=blue, label="first start", **looks)),
        (most_starts > 1, Line2D([], [], color=(1.0, 1.0, 1.0), label="other start", **looks)),
    )
    return [entry for drawn, entry in entries if drawn]


def _path(shape: Shape) -> Path:
    """A shape with its holes as one path."""
    return Path.make_compound_path(*(Path(np.vstack([ring, ring[:1]]), closed=True) for ring in shape))
