"""Figures of benchmarks, with matplotlib."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from benchmarks.common import Figures

MARKERS = "osD^vPX"


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
