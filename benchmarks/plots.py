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
    figure = Figure(figsize=(4.2 * len(panels), 4.0), layout="constrained")
    all_axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, (title, (ticks, lines)) in zip(all_axes, panels.items(), strict=True):
        for k, (name, estimates) in enumerate(lines.items()):
            value, low, high = (np.array([e[end] for e in estimates], float) for end in ("value", "low", "high"))
            at = np.arange(len(ticks)) + 0.04 * (k - 0.5 * len(lines))
            bars = np.abs([value - low, high - value])
            axes.errorbar(at, value, bars, label=name, marker=MARKERS[k % len(MARKERS)], markersize=4, capsize=2)
        axes.set(title=title, xticks=range(len(ticks)), xticklabels=ticks)
        axes.grid(alpha=0.3)
    for axes in all_axes:  # after the lines: a log scale over a single value has no limits to draw the next one in
        if log:
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_minor_formatter(NullFormatter())
        axes.yaxis.set_major_formatter("{x:g}")
    all_axes[0].set_ylabel(y)
    figure.legend(*all_axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    return figure


def band_panels(rows: Mapping[str, Mapping[str, Panel]], y: str) -> Figure:
    """A row per axis, in it a panel per title, with a line per name and its 95 % interval as a band, all in grey."""
    across = max(map(len, rows.values()))
    figure = Figure(figsize=(2.6 * across + 0.6, 2.7 * len(rows)), layout="constrained")
    grid = figure.subplots(len(rows), across, sharey=True, squeeze=False)
    for all_axes, (x, panels) in zip(grid, rows.items(), strict=True):
        for axes, (title, panel) in zip(all_axes, panels.items(), strict=True):
            draw_bands(axes, panel)
            axes.set(title=title, xlabel=x, ylim=(0.0, 1.0))
        all_axes[0].set_ylabel(y)
    for axes in grid[0][:2]:  # the other panels have the lines of the second
        axes.legend(fontsize=7, frameon=False, loc="lower left", handlelength=3.0)
    return figure


def draw_bands(axes: Axes, panel: Panel) -> None:
    """Draw the lines of a panel, told apart by marker, dashes and grey."""
    at = np.arange(len(panel.ticks))
    for k, (name, estimates) in enumerate(panel.lines.items()):
        value, low, high = (np.array([e[end] for e in estimates], float) for end in ("value", "low", "high"))
        marker, dashes, grey = (choices[k % len(choices)] for choices in (MARKERS, DASHES, GREYS))
        axes.plot(at, value, label=name, marker=marker, markersize=4, linestyle=dashes, color=grey, linewidth=1.2)
        axes.fill_between(at, low, high, color=grey, alpha=0.15, linewidth=0.0)
    axes.set(xticks=at, xticklabels=panel.ticks)
    axes.grid(alpha=0.3)
