"""The coverage curves of a comparison as a PNG."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agents.comparison import SHARES_OF_BUDGET
from agents.curve import BUDGET_M_PER_M2
from agents.page import name_of

COLOURS = ("#1f5ac8", "#e08c00", "#148c5a", "#b01830", "#784aa0", "#46afaa", "#96765a", "#5a6978")
INK, FAINT = "#262c36", "#8c929c"


def draw_curves(rows: list[dict[str, Any]], title: str, path: Path) -> None:
    """Write the mean coverage over the metres driven, a band of its 95 % interval for every row.

    Rows whose pose is known are dashed, in the colour of their policy.
    """
    figure = Figure(figsize=(8.0, 4.6), layout="constrained")
    axes = figure.add_subplot()
    policies = list(dict.fromkeys(row["policy"] for row in rows))
    for row in rows:
        draw_row(axes, row, COLOURS[policies.index(row["policy"]) % len(COLOURS)])
    dress(axes, title)
    figure.savefig(path, dpi=110, metadata={"Software": None})


def draw_row(axes: Axes, row: dict[str, Any], colour: str) -> None:
    """One curve; the band only where the robot must find out its pose."""
    low, value, high = ([point[end] for point in row["curve"]] for end in ("low", "value", "high"))
    known = row["estimator"] == "truth"
    area = f"{row['figures']['auc']['value']:.3f}"
    label = f"{name_of(row)}  {area}"
    axes.plot(
        SHARES_OF_BUDGET,
        value,
        color=colour,
        linewidth=1.0 if known else 2.0,
        linestyle="--" if known else "-",
        label=label,
    )
    if not known:
        axes.fill_between(SHARES_OF_BUDGET, low, high, color=colour, alpha=0.15, linewidth=0.0)


def dress(axes: Axes, title: str) -> None:
    """Axes, legend and title."""
    axes.set_title(title, loc="left", fontsize=11, color=INK)
    axes.set_xlabel(f"metres driven, as a share of the building's budget ({BUDGET_M_PER_M2:g} m on a m² of floor)")
    axes.set_ylabel("floor seen")
    axes.set_xlim(0.0, float(SHARES_OF_BUDGET[-1]))
    axes.set_ylim(0.0, 1.02)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:.0%}")
    axes.axvline(1.0, color=FAINT, linewidth=0.8, linestyle=":")
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="lower right", frameon=False, fontsize=8, title="area under the curve up to 1", title_fontsize=8)
