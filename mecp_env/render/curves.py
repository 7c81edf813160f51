"""A run over time as a figure: pose error and 3 sigma, NEES with its band, coverage, landmarks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mecp_env.core.text import sanitised
from mecp_env.render import palette
from mecp_env.render.palette import unit
from mecp_env.render.view import SceneView

NEES_BAND = 0.216, 9.348  # 95 % of a chi-square of 3 degrees of freedom
LEAST_NEES = 0.02

Moment = Mapping[str, float]


def moment_of(view: SceneView) -> Moment:
    """What the curves show of one step: the metrics, and 3 sigma of the position (m) along its longer axis."""
    cov = view.slam_output.belief.pose_cov[:2, :2]
    return {**view.metrics, "sigma3_m": 3.0 * math.sqrt(max(float(np.linalg.eigvalsh(cov)[-1]), 0.0))}


def curves_figure(title: str, period_s: float, moments: Sequence[Moment]) -> Figure:
    """The curves of a run whose steps are `period_s` apart, from the first one on."""
    figure = Figure(figsize=(11.0, 6.0), layout="constrained")
    position, nees, floor, landmarks = figure.subplots(2, 2, sharex=True).ravel()
    t = period_s * np.arange(len(moments))

    def draw(axes: Axes, name: str, colour: palette.RGB, label: str, factor: float = 1.0) -> None:
        axes.plot(
            t, [factor * moment.get(name, math.nan) for moment in moments], color=unit(colour), lw=1.2, label=label
        )

    draw(position, "sigma3_m", palette.FAINT, "3 sigma", 100.0)
    draw(position, "pose_error_m", palette.HIT, "error", 100.0)
    draw(floor, "coverage", palette.FAINT, "coverage", 100.0)
    draw(floor, "correct_coverage", palette.GOAL, "correct coverage", 100.0)
    draw(landmarks, "landmarks", palette.LANDMARK, "landmarks")
    draw(landmarks, "rooms_found", palette.ROOMS[0], "rooms found")
    draw(landmarks, "doors_found", palette.DOOR, "doors found")
    nees.axhspan(*NEES_BAND, color=unit(palette.BEAM), alpha=0.25, lw=0, label="95 % of a consistent filter")
    nees.semilogy(t, [max(m.get("nees", math.nan), LEAST_NEES) for m in moments], color=unit(palette.ESTIMATE), lw=1.0)
    words = {
        position: "position, cm",
        nees: "NEES of the pose (3 expected)",
        floor: "floor, %",
        landmarks: "on the map",
    }
    for axes, name in words.items():
        axes.set_title(name, loc="left", fontsize=10)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25)
        axes.legend(frameon=False, fontsize=8)
        axes.tick_params(labelsize=8)
    for axes in (floor, landmarks):
        axes.set_xlabel("s", fontsize=9)
    figure.suptitle(sanitised(title), x=0.01, ha="left", fontsize=12, parse_math=False)
    return figure
