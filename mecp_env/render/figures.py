"""A run over time: pose error and 3 sigma, NEES, coverage, landmarks. Legends that name what is drawn alone."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import Collection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from mecp_env.core.files import sanitised
from mecp_env.render import palette
from mecp_env.render.palette import unit
from mecp_env.render.shapes import SceneView

DPI = 220  # a figure has at least twice the pixels of the place where a page shows it
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
    """Write a figure as PNG or SVG, by the ending of `path`; without date: the same figure gives the same file."""
    nameless = {"Date": None, "Creator": None} if path.suffix.lower() == ".svg" else {"Software": None}
    with rc_context({"svg.hashsalt": "mecp_env"}), boxes_for_missing_glyphs():
        figure.savefig(path, dpi=dpi, metadata=nameless)


@contextmanager
def boxes_for_missing_glyphs() -> Iterator[None]:
    """Names in any script: matplotlib draws a box for what its font has not, and need not warn."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")
        yield


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
