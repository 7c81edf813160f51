"""Figures of benchmarks, with matplotlib."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from PIL import Image

from benchmarks.common import Figures
from mecp_env.render.figures import drawn
from mecp_env.render.palette import SERIES, unit

MOST_ACROSS, PANEL_IN = 3, (3.9, 3.2)  # panels of a row, and their size: letters of 10 pt are 8 px on a page
LEGEND_LINE_IN = 0.22
MARKERS = "osD^vPX<>h"
DASHES = ("-", "--", ":", "-.", (0, (1, 3)), (0, (5, 4)), (0, (3, 1, 1, 1, 1, 1)))


class Panel(NamedTuple):
    """The content of one panel."""

    ticks: Sequence[str]
    lines: Mapping[str, Sequence[Figures]]  # name -> an estimate per tick


def line_panels(panels: Mapping[str, Panel], y: str, log: bool = False) -> Figure:
    """A panel per title, in it a line per name through its estimates with their 95 % intervals."""
    return panel_rows({"": panels}, y, log)


def panel_rows(rows: Mapping[str, Mapping[str, Panel]], y: str, log: bool = False, sharey: bool = True) -> Figure:
    """Rows of panels per name of the x axis, in them a panel per title as of `line_panels`, and one legend below."""
    places = [(x, part) for x, panels in rows.items() for part in in_rows(list(panels.items()))]
    across = max(len(part) for _, part in places)
    names = max(len(panel.lines) for _, part in places for _, panel in part)
    height = PANEL_IN[1] * len(places) + LEGEND_LINE_IN * -(-names // MOST_ACROSS)
    figure = Figure(figsize=(PANEL_IN[0] * across, height), layout="constrained")
    grid = figure.subplots(len(places), across, sharey=sharey, squeeze=False)
    for all_axes, (x, part) in zip(grid, places, strict=True):
        for axes, (title, panel) in zip(all_axes, part, strict=False):
            draw_lines(axes, panel)
            axes.set(title=title, xlabel=x)
        for axes in all_axes[len(part) :]:
            axes.remove()
        all_axes[0].set_ylabel(y)
    for axes in figure.axes:  # after the lines: a log scale over a single value has no limits to draw the next one in
        if log and np.isfinite(axes.dataLim.minposy):  # something is above 0
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_minor_formatter(NullFormatter())
        axes.yaxis.set_major_formatter("{x:g}")
    figure.legend(**drawn(grid[0][0]), loc="outside lower center", ncols=MOST_ACROSS, frameon=False)
    return figure


def in_rows(panels: list[Any]) -> list[list[Any]]:
    """Panels in rows of at most `MOST_ACROSS`."""
    return [panels[first : first + MOST_ACROSS] for first in range(0, len(panels), MOST_ACROSS)]


def draw_lines(axes: Axes, panel: Panel) -> None:
    """Draw the lines of a panel, a little beside each other, with their 95 % intervals as bars.

    Colour, marker and dashes tell them apart.
    """
    for k, (name, estimates) in enumerate(panel.lines.items()):
        value, low, high = (np.array([e[end] for e in estimates], float) for end in ("value", "low", "high"))
        at = np.arange(len(panel.ticks)) + 0.04 * (k - 0.5 * len(panel.lines))
        bars = np.abs([value - low, high - value])
        colour, marker = SERIES[k % len(SERIES)], MARKERS[k % len(MARKERS)]
        dashes = DASHES[(k + k // len(SERIES)) % len(DASHES)]  # others where colours come again
        looks: dict[str, Any] = {"color": unit(colour), "marker": marker, "linestyle": dashes}
        axes.errorbar(at, value, bars, label=name, markersize=5, capsize=2, linewidth=1.3, **looks)
    axes.set(xticks=range(len(panel.ticks)), xticklabels=panel.ticks)
    axes.grid(alpha=0.3)


def pictures_figure(pictures: Mapping[str, Path]) -> Figure:
    """A picture below each title."""
    rows = in_rows(list(pictures.items()))
    figure = Figure(figsize=(5.0 * MOST_ACROSS, 3.6 * max(len(rows), 1)), layout="constrained")
    for axes in (all_axes := figure.subplots(max(len(rows), 1), MOST_ACROSS, squeeze=False).ravel()):
        axes.set_axis_off()
    for axes, (title, path) in zip(all_axes, pictures.items(), strict=False):
        axes.imshow(Image.open(path))
        axes.set_title(title, fontsize=10)
    return figure
