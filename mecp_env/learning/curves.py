"""The curves of a training as a PNG: return, correct coverage and lost episodes over the decisions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from mecp_env.core.carriers import Array
from mecp_env.learning.run_folder import EVALUATION, TRAINING, CsvTable
from mecp_env.render.figures import drawn

CURVES = "curves.png"
PANELS = (  # column, label with its unit, factor
    ("reward", "return, no unit", 1.0),
    ("correct_coverage", "correct coverage at the end, %", 100.0),
    ("lost", "lost episodes, %", 100.0),
)
SMOOTHED = 7  # updates in a running mean; the episodes of a single one are few
TRAINED, VALIDATED = "#0072b2", "#d55e00"  # of Okabe and Ito
DPI = 200


def draw_training(folder: Path) -> Path | None:
    """Draw the curves of the run in a folder from its tables. Their file, or None before the first update.

    Points are the means of the episodes that finished in an update (actions are sampled), the line their running mean;
    squares are the evaluations on the validation split (the most probable action).
    """
    updates, evaluations = (
        CsvTable(folder / name, columns).rows()
        for name, columns in (("progress.csv", TRAINING), ("evaluation.csv", EVALUATION))
    )
    if not updates:
        return None
    panels = [panel for panel in PANELS if len(measured(updates, panel[0])[1])] or PANELS[:1]
    figure = Figure(figsize=(3.5 * len(panels), 3.4), layout="constrained")
    for axes, (name, title, factor) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        decisions, values = measured(updates, name)
        axes.plot(decisions, factor * values, ".", color=TRAINED, alpha=0.3, label="episodes of an update")
        axes.plot(decisions, factor * running_mean(values), color=TRAINED, label=f"mean of {SMOOTHED} updates")
        decisions, values = measured(evaluations, name)
        axes.plot(decisions, factor * values, "s", color=VALIDATED, markersize=6, label="validation")
        dress(axes, title)
    named = drawn(figure.axes[0])
    if named["handles"]:
        figure.legend(**named, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    figure.savefig(folder / CURVES, dpi=DPI, metadata={"Software": None})
    return folder / CURVES


def measured(rows: Sequence[Mapping[str, str]], name: str) -> tuple[Array, Array]:
    """(n,) decisions and (n,) values of a column, of the rows that have a number there."""
    pairs = [(float(row["decisions"]), float(row.get(name) or math.nan)) for row in rows]
    table = np.array(pairs, float).reshape(-1, 2)
    table = table[np.isfinite(table[:, 1])]
    return table[:, 0], table[:, 1]


def running_mean(values: Array) -> Array:
    """(n,) the mean of up to `SMOOTHED` values around each; fewer at the ends."""
    half = SMOOTHED // 2
    return np.array([values[max(0, i - half) : i + half + 1].mean() for i in range(len(values))])


def dress(axes: Axes, title: str) -> None:
    """Labels and grid."""
    axes.set_ylabel(title, fontsize=10)
    axes.set_xlabel("decisions, thousand", fontsize=10)
    axes.xaxis.set_major_locator(MaxNLocator(6))
    axes.xaxis.set_major_formatter(lambda value, _: f"{value / 1000:g}")
    axes.tick_params(labelsize=9)
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
