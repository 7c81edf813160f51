"""Maps of the benchmark `real` as small multiples: walls, paths, landmarks and doors of each."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from benchmarks.common import Figures
from mecp_env.core.carriers import Array
from mecp_env.core.se2 import to_map
from mecp_env.render import palette
from mecp_env.render.palette import unit
from mecp_env.slam.output import SlamOutput

COLUMNS = 3
WIDTH_IN, HEIGHT_IN = 5.0, 3.6  # of one map
SCALE_M = 5.0  # length of the bar in each map
SAID = {  # of a log, above its map
    "final_relations_m": "final relations",
    "final_ate_m": "final trajectory error",
    "dead_reckoning_ate_m": "dead reckoning",
}


class MapData(NamedTuple):
    """What is drawn of a map; all in one frame, m."""

    segments: Array  # (s,2,2) true walls
    cells: Array  # (c,2) mapped walls, where the true ones are not known
    reference: Array  # (n,2) true or reference path
    path: Array  # (n,2) estimated path
    landmarks: Array  # (l,2)
    doors: Array  # (d,2,2) jambs of each face

    @classmethod
    def of_output(cls, output: SlamOutput, T_map: Array | None = None, **known: Array) -> Self:
        """Landmarks and doors of an output, moved by the pose `T_map` (3,) of the map, and what is `known`."""
        belief = output.belief
        p = to_map(np.zeros(3) if T_map is None else T_map, np.ascontiguousarray(belief.p_map))
        faces = [face for door in output.graph.doors for face in (door.jambs, door.other_face) if face is not None]
        doors = np.array([p[belief.rows(np.array(face))] for face in faces]).reshape(-1, 2, 2)
        empty = {"segments": np.empty((0, 2, 2)), "cells": np.empty((0, 2))}
        return cls(**empty | known | {"landmarks": p, "doors": doors})

    @classmethod
    def of_env(cls, env: Any) -> Self:
        """What is drawn of an exploration, in the world frame."""
        view = env.get_wrapper_attr("view")()
        paths = {"reference": view.path_world, "path": view.to_world(view.path_map)}
        return cls.of_output(view.slam_output, view.T_world_map, segments=view.segments, **paths)

    def save(self, path: Path) -> None:
        """Write the map as a NumPy archive."""
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(path, **{name: array.astype(np.float32) for name, array in self._asdict().items()})

    @classmethod
    def load(cls, path: Path) -> Self:
        """The map in an archive."""
        with np.load(path) as archive:
            return cls(*(archive[name] for name in cls._fields))


def small_multiples(maps: Mapping[str, MapData]) -> Figure:
    """A map below each title."""
    rows = max(1, -(-len(maps) // COLUMNS))
    figure = Figure(figsize=(WIDTH_IN * COLUMNS, HEIGHT_IN * rows + 0.4), layout="constrained")
    all_axes = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    for axes in all_axes:
        axes.set_axis_off()
    for axes, (title, drawn) in zip(all_axes, maps.items(), strict=False):
        draw(axes, drawn)
        axes.set_title(title.replace(": ", ":\n", 1).replace(", dead", ",\ndead"), fontsize=8)
    handles = {label: line for axes in all_axes for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=6, frameon=False, fontsize=9)
    return figure


def draw(axes: Axes, drawn: MapData) -> None:
    """One map, with a bar of five metres."""
    if len(drawn.segments):
        axes.add_collection(
            LineCollection(list(drawn.segments), colors=unit(palette.TRUE_WALL), linewidths=1.0, label="true walls")
        )
    if len(drawn.cells):
        axes.plot(*drawn.cells.T, ",", color=unit(palette.INK), label="mapped walls")
    axes.plot(*drawn.reference.T, color=unit(palette.TRUE_PATH), linewidth=1.6, label="true or reference path")
    axes.plot(*drawn.path.T, color=unit(palette.ESTIMATE), linewidth=0.6, label="estimated path")
    axes.plot(*drawn.landmarks.T, "+", color=unit(palette.LANDMARK), markersize=2.5, mew=0.5, label="landmark")
    axes.add_collection(LineCollection(list(drawn.doors), colors=unit(palette.DOOR), linewidths=2.0, label="door"))
    axes.set_aspect("equal")
    axes.autoscale_view()
    (left, _), (low, _) = axes.get_xlim(), axes.get_ylim()
    axes.plot([left, left + SCALE_M], [low, low], color=unit(palette.INK), linewidth=2.0, label=f"{SCALE_M:g} m")


def short(name: str) -> str:
    """A name that fits in a column."""
    return name if len(name) <= 20 else f"{name[:8]}..."


def caption(figures: Figures, name: str) -> str:
    """What is said above a map."""
    if name not in figures:
        of = figures["explored"][name]
        return f"{short(name)}: {of['free_area_m2']:,.0f} m2, pose RMSE {100.0 * of['pose_rmse_m']['value']:.1f} cm"
    said = [f"{text} {mean(figures[name][key]):.2f} m" for key, text in SAID.items() if key in figures[name]]
    return f"{name}, {mean(figures[name]['log_share']):.0%} of the log: {', '.join(said)}"


def mean(figure: Any) -> float:
    """An estimate or a number as a number."""
    return float(figure["value"] if isinstance(figure, dict) else figure)
