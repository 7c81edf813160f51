"""Floor plans with matplotlib: one building, or several on a sheet. The same plans give the same file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, PathPatch, Polygon
from matplotlib.path import Path
from numpy.typing import NDArray

from mecp_env.core.errors import ConfigError
from mecp_env.core.text import sanitised
from mecp_env.render import palette
from mecp_env.render.figures import boxes_for_missing_glyphs
from mecp_env.render.floor_plan import LINES, FloorPlan, PlanRoom, Shape
from mecp_env.render.palette import unit

Array = NDArray[np.float64]

FORMATS = (".png", ".svg")
ALONE_IN, ON_SHEET_IN = (9.6, 7.6), (4.2, 3.5)  # width and height that a plan may have, inches
LEAST_IN = 5.2  # width of the drawing of one building, so that its title fits
MARGIN_IN, HEAD_IN, BAR_IN, FOOT_IN = 0.3, 0.68, 0.38, 0.4
MOST_ON_SHEET = 100
LARGEST_PT, SMALLEST_PT = 11.0, 4.0  # of a room's name
POINTS_PER_INCH = 72.0
WOOD: palette.RGB = (212, 200, 184)
BARS_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0)


@dataclass(frozen=True, slots=True)
class PlanAxes:
    """The place of one plan on the paper."""

    axes: Axes  # in metres, world frame
    points_per_m: float


def check_format(path: FilePath) -> FilePath:
    """`path` itself. Raises `ConfigError` when its ending is that of no picture that can be drawn."""
    if path.suffix.lower() not in FORMATS:
        raise ConfigError(f"out: {path}: a picture ends in {' or '.join(FORMATS)}, given {path.suffix!r}")
    return path


def check_count(count: int) -> None:
    """Raise `ConfigError` when so many buildings cannot be drawn on a sheet."""
    if not 1 <= count <= MOST_ON_SHEET:
        raise ConfigError(f"{count} buildings cannot be drawn on one sheet, from 1 to {MOST_ON_SHEET} can")


def save_plans(plans: Sequence[FloorPlan], path: FilePath, dpi: int = 150) -> None:
    """Draw plans and write them as PNG or SVG, by the ending of `path`; without date."""
    check_format(path)
    with mpl.rc_context({"svg.hashsalt": "mecp_env"}), boxes_for_missing_glyphs():
        figure = plans_figure(plans)
        nameless = {"Date": None, "Creator": None} if path.suffix.lower() == ".svg" else {"Software": None}
        figure.savefig(path, dpi=dpi, metadata=nameless)


def plans_figure(plans: Sequence[FloorPlan]) -> Figure:
    """One plan, or several in rows. Raises `ConfigError` for none, or more than fit on a sheet."""
    check_count(len(plans))
    columns = math.ceil(math.sqrt(len(plans)))
    rows = math.ceil(len(plans) / columns)
    room_in = ON_SHEET_IN if len(plans) > 1 else _snug(plans[0])
    cell_in = (room_in[0] + 2 * MARGIN_IN, room_in[1] + HEAD_IN + BAR_IN)
    size = np.array([columns * cell_in[0], rows * cell_in[1] + FOOT_IN])
    figure = Figure(figsize=tuple(size), facecolor="white")
    for plan, corner in zip(plans, _corners(rows, columns, cell_in), strict=False):
        _draw_plan(_cell(figure, plan, (corner, room_in), size), plan)
        title_in = corner + np.array([MARGIN_IN, cell_in[1] - 0.12])
        _write_title(figure, plan, title_in / size, alone=len(plans) == 1)
    left = (MARGIN_IN / size[0], 0.1 / size[1])
    figure.legend(
        handles=_legend(), loc="lower left", ncols=4, frameon=False, fontsize=8, bbox_to_anchor=left, borderpad=0
    )
    return figure


def _snug(plan: FloorPlan) -> tuple[float, float]:
    """The room that a plan by itself takes up, inches."""
    width, height = plan.bounds[1] - plan.bounds[0]
    scale = min(ALONE_IN[0] / width, ALONE_IN[1] / height)
    return max(scale * width, LEAST_IN), scale * height


def _corners(rows: int, columns: int, cell_in: tuple[float, float]) -> Iterator[Array]:
    """Lower left corners (2,) of the cells, inches, row by row from the top."""
    for index in range(rows * columns):
        row, column = divmod(index, columns)
        yield np.array([column * cell_in[0], FOOT_IN + (rows - 1 - row) * cell_in[1]])


def _cell(figure: Figure, plan: FloorPlan, place: tuple[Array, tuple[float, float]], size: Array) -> PlanAxes:
    """Axes in metres over the room of a cell: the plan in the middle, as large as it fits."""
    (corner, room_in), bounds = place, plan.bounds
    extent = bounds[1] - bounds[0]
    scale = float(np.min(np.array(room_in) / extent))  # inches / m
    low = corner + (MARGIN_IN, BAR_IN) + (np.array(room_in) - scale * extent) / 2.0
    below, aside = BAR_IN, MARGIN_IN  # the axes reach over the scale bar and the margins
    origin, span = low - (aside, below), scale * extent + (2 * aside, below + 0.05)
    axes = figure.add_axes((*(origin / size), *(span / size)))
    axes.set_xlim(bounds[0, 0] - aside / scale, bounds[1, 0] + aside / scale)
    axes.set_ylim(bounds[0, 1] - below / scale, bounds[1, 1] + 0.05 / scale)
    axes.set_axis_off()
    return PlanAxes(axes, POINTS_PER_INCH * scale)


def _draw_plan(cell: PlanAxes, plan: FloorPlan) -> None:
    """Floors, furniture, walls over both, gaps of doors over the walls, then what is written."""
    for room in plan.rooms:
        cell.axes.add_patch(Polygon(room.ring, facecolor=_soft(room.colour, 0.74), edgecolor="none"))
    for ring in plan.obstacles:
        edge = unit(palette.mix(WOOD, palette.INK, 0.45))
        cell.axes.add_patch(Polygon(ring, facecolor=unit(WOOD), edgecolor=edge, linewidth=0.6))
    for shape in plan.walls:
        cell.axes.add_patch(PathPatch(_path(shape), facecolor=unit(palette.SOLID), edgecolor="none"))
    for gap in plan.doors:
        _draw_door(cell.axes, gap)
    for index, start in enumerate(plan.starts):
        _draw_start(cell, start, first=index == 0)
    for room in plan.rooms:
        _name_room(cell, room)
    _draw_bar(cell, plan.bounds)


def _draw_door(axes: Axes, gap: Array) -> None:
    """The floor continues through the wall; a line in amber is the threshold."""
    axes.add_patch(Polygon(gap, facecolor="white", edgecolor="white", linewidth=0.5))
    ends = np.stack([gap[:2].mean(axis=0), gap[2:].mean(axis=0)])
    axes.plot(*ends.T, color=unit(palette.DOOR), linewidth=2.0, solid_capstyle="butt")


def _draw_start(cell: PlanAxes, start: Array, first: bool) -> None:
    """A disc of the robot's size with its nose; the first one is filled."""
    x, y, heading = start
    blue, radius = unit(palette.ESTIMATE), 0.22
    cell.axes.add_patch(Circle((x, y), radius, facecolor=blue if first else "white", edgecolor=blue, linewidth=0.9))
    nose = np.array([[x, y], [x + radius * math.cos(heading), y + radius * math.sin(heading)]])
    cell.axes.plot(*nose.T, color="white" if first else blue, linewidth=min(1.2, 0.05 * cell.points_per_m))


def _name_room(cell: PlanAxes, room: PlanRoom) -> None:
    """Name and area, as large as there is space; nothing where it could not be read."""
    fitting = cell.points_per_m * room.label_height_m / LINES
    if fitting < SMALLEST_PT:
        return
    size = min(fitting, LARGEST_PT)
    ink = unit(palette.mix(palette.ROOMS[room.colour % len(palette.ROOMS)], palette.INK, 0.6))
    angle = math.radians(room.label_turn_deg)
    up = np.array([-math.sin(angle), math.cos(angle)])
    for words, lift, points in ((sanitised(room.name), 0.55, size), (f"{room.area_m2:.1f} m²", -0.55, 0.75 * size)):
        dx, dy = lift * size * up
        text = cell.axes.annotate(words, room.label, (dx, dy), textcoords="offset points", fontsize=points, color=ink)
        text.set(ha="center", va="center_baseline", rotation=room.label_turn_deg, rotation_mode="anchor")
        text.set_parse_math(False)


def _draw_bar(cell: PlanAxes, bounds: Array) -> None:
    """A scale bar below the plan's right corner, about a quarter of it long."""
    width, right, inch = bounds[1, 0] - bounds[0, 0], bounds[1, 0], POINTS_PER_INCH / cell.points_per_m
    length = max((bar for bar in BARS_M if bar <= width / 3.0), default=BARS_M[0])
    y = bounds[0, 1] - 0.17 * inch
    for part, colour in ((0.0, palette.INK), (0.5, palette.UNSEEN)):
        ends = [right - length * (1.0 - part), right - length * (0.5 - part)]
        cell.axes.plot(ends, [y, y], color=unit(colour), linewidth=3.5, solid_capstyle="butt")
    cell.axes.text(right - length - 0.08 * inch, y, f"{length:g} m", ha="right", va="center", fontsize=8)


def _write_title(figure: Figure, plan: FloorPlan, place: Array, alone: bool) -> None:
    big, small = (14.0, 9.0) if alone else (10.0, 7.0)
    x, y = place
    line = big * 1.45 / POINTS_PER_INCH / figure.get_figheight()
    name = figure.text(x, y, sanitised(plan.name), fontsize=big, fontweight="bold", va="top", color=unit(palette.INK))
    name.set_parse_math(False)
    figure.text(
        x, y - line, plan.summary, fontsize=small, va="top", color=unit(palette.mix(palette.INK, palette.FREE, 0.4))
    )


def _legend() -> list[Patch | Line2D]:
    blue, edge = unit(palette.ESTIMATE), unit(palette.mix(WOOD, palette.INK, 0.45))
    dots = [
        Line2D([], [], color=inside, marker="o", markeredgecolor=blue, markersize=7, linestyle="none", label=name)
        for inside, name in ((blue, "first start"), ((1.0, 1.0, 1.0), "other start"))
    ]
    return [
        Line2D([], [], color=unit(palette.DOOR), linewidth=2.0, label="door"),
        Patch(facecolor=unit(WOOD), edgecolor=edge, label="obstacle"),
        *dots,
    ]


def _soft(colour: int, share: float) -> tuple[float, float, float]:
    return unit(palette.mix(palette.ROOMS[colour % len(palette.ROOMS)], palette.FREE, share))


def _path(shape: Shape) -> Path:
    """A shape with its holes as one path."""
    return Path.make_compound_path(*(Path(np.vstack([ring, ring[:1]]), closed=True) for ring in shape))
