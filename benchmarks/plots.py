"""Figures of benchmarks, with matplotlib."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from benchmarks.common import Figures

MARKERS = "osD^vPX<>h"
DASHES = ("-", "--", ":", "-.", (0, (1, 3)), (0, (5, 4)), (0, (3, 1, 1, 1, 1, 1)))
GREYS = ("0.0", "0.35", "0.55", "0.15", "0.45", "0.25", "0.6")


class Panel(NamedTuple):
    """The content of one panel."""

    ticks: Sequence[str]
    lines: Mapping[str, Sequence[Figures]]  # name -> an estimate per tick


def line_panels(panels: Mapping[str, Panel], y: str, log: bool = False) -> Figure:
    """A panel per title, in it a line per name through its estimates with their 95 % intervals."""
    return panel_rows({"": panels}, y, log)


def panel_rows(rows: Mapping[str, Mapping[str, Panel]], y: str, log: bool = False) -> Figure:
    """A row per name of the x axis, in it a panel per title as of `line_panels`; one legend, and the titles on top."""
    across = max(map(len, rows.values()))
    figure = Figure(figsize=(4.2 * across, 4.0 * len(rows)), layout="constrained")
    grid = figure.subplots(len(rows), across, sharey=True, squeeze=False)
    for all_axes, (x, panels) in zip(grid, rows.items(), strict=True):
        for axes, (title, panel) in zip(all_axes, panels.items(), strict=True):
            draw_lines(axes, panel)
            axes.set(title=title, xlabel=x)
        all_axes[0].set_ylabel(y)
    for axes in grid.flat:  # after the lines: a log scale over a single value has no limits to draw the next one in
        if log:
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_minor_formatter(NullFormatter())
        axes.yaxis.set_major_formatter("{x:g}")
    figure.legend(*grid[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    return figure


def draw_lines(axes: Axes, panel: Panel) -> None:
    """Draw the lines of a panel in colours, a little beside each other, with their 95 % intervals as bars."""
    for k, (name, estimates) in enumerate(panel.lines.items()):
        value, low, high = (np.array([e[end] for e in estimates], float) for end in ("value", "low", "high"))
        at = np.arange(len(panel.ticks)) + 0.04 * (k - 0.5 * len(panel.lines))
        bars = np.abs([value - low, high - value])
        axes.errorbar(at, value, bars, label=name, marker=MARKERS[k % len(MARKERS)], markersize=4, capsize=2)
    axes.set(xticks=range(len(panel.ticks)), xticklabels=panel.ticks)
    axes.grid(alpha=0.3)


def draw_bands(axes: Axes, panel: Panel) -> None:
    """Draw the lines of a panel, told apart by marker, dashes and grey, and their 95 % intervals as bands."""
    at = np.arange(len(panel.ticks))
    for k, (name, estimates) in enumerate(panel.lines.items()):
        value, low, high = (np.array([e[end] for e in estimates], float) for end in ("value", "low", "high"))
        marker, dashes, grey = (choices[k % len(choices)] for choices in (MARKERS, DASHES, GREYS))
        axes.plot(at, value, label=name, marker=marker, markersize=4, linestyle=dashes, color=grey, linewidth=1.2)
        axes.fill_between(at, low, high, color=grey, alpha=0.15, linewidth=0.0)
    axes.set(xticks=at, xticklabels=panel.ticks)
    axes.grid(alpha=0.3)
