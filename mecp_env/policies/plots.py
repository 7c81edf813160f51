"""The coverage curves of a comparison as a PNG."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mecp_env.core.files import sanitised
from mecp_env.core.intervals import BUDGET_M_PER_M2, Figures
from mecp_env.policies.comparison import SHARES_OF_BUDGET
from mecp_env.render.palette import FAINT, INK, MARKERS, SERIES, unit

DPI = 200
MARK_EVERY = 0.12  # of the diagonal, from marker to marker of a curve


def draw_curves(rows: list[Figures], title: str, path: Path) -> None:
    """Write the mean coverage over the metres driven as a PNG.

    The first row of each policy has a band, its 95 % interval; the row with the pose known is dashed.
    """
    figure = Figure(figsize=(9.0, 4.6), layout="constrained")
    axes = figure.add_subplot()
    for number, policy in enumerate(dict.fromkeys(row["policy"] for row in rows)):
        draw_policy(axes, [row for row in rows if row["policy"] == policy], number)
    dress(axes, title)
    heading = "area under the curve up to 1\n(dashed: pose known)"
    figure.legend(loc="outside right upper", frameon=False, fontsize=9, title=heading, title_fontsize=9)
    figure.savefig(path, dpi=DPI, metadata={"Software": None})


def draw_policy(axes: Axes, rows: list[Figures], number: int) -> None:
    """The curves of one policy in its colour and with its marker, the first with its band and the areas under both."""
    colour, marker = (choices[number % len(choices)] for choices in (list(map(unit, SERIES)), MARKERS))
    low, value, high = ([point[end] for point in rows[0]["curve"]] for end in ("low", "value", "high"))
    area, *known = (f"{row['figures']['auc']['value']:.3f}" for row in rows)
    label = f"{sanitised(rows[0]['policy'])}  {area}" + "".join(f" ({other})" for other in known)
    looks: dict[str, Any] = {"marker": marker, "markersize": 5, "markevery": (0.02 * (number % 6), MARK_EVERY)}
    axes.plot(SHARES_OF_BUDGET, value, color=colour, linewidth=1.8, label=label, **looks)
    axes.fill_between(SHARES_OF_BUDGET, low, high, color=colour, alpha=0.15, linewidth=0.0)
    for row in rows[1:]:
        axes.plot(SHARES_OF_BUDGET, [point["value"] for point in row["curve"]], "--", color=colour, linewidth=1.0)


def dress(axes: Axes, title: str) -> None:
    """Axes, legend and title."""
    axes.set_title(title, loc="left", fontsize=11, color=unit(INK))
    axes.set_xlabel(f"metres driven, as a share of the building's budget ({BUDGET_M_PER_M2:g} m per m² of floor)")
    axes.set_ylabel("floor seen, %")
    axes.set_xlim(0.0, float(SHARES_OF_BUDGET[-1]))
    axes.set_ylim(0.0, 1.02)
    axes.yaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f}")
    axes.axvline(1.0, color=unit(FAINT), linewidth=0.8, linestyle=":")
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
