"""Corners of single scans against ground truth: precision, recall, error, calibration, cost, clustering thresholds.

The poses are random in the free space of every included layout. A corner is correct when a visible true corner lies
within 0.25 m, is convex or concave like it, and has faces with the same directions; pairs are one to one. A true corner
is detectable when both its faces are at least 0.35 m long and at least 5 beams of one sweep and 0.3 m of a face next to
it are visible.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from benchmarks.common import Figures, Options, estimate, in_parallel, ratio
from benchmarks.corner_scores import Preset, Score, make_places, score_places
from benchmarks.tables import one_table, sections, table_of
from mecp_env.core.carriers import Array
from mecp_env.slam.config import ClusteringConfig, SlamConfig
from mecp_env.slam.messages import CornerKind
from mecp_env.world.layout import shipped_layouts

SEED = 1  # not the seed used for tuning
PRESETS = tuple((preset, sweeps) for preset in ("paper", "lms200", "ideal") for sweeps in (4, 1))
ABLATED = PRESETS[:4]
THRESHOLDS = ("adaptive_noise", "adaptive", "fixed_0.1", "fixed_0.2", "fixed_0.3", "fixed_0.4", "fixed_0.5")
RANGE_BINS_M = (0.0, 2.0, 4.0, 8.0, 30.0)
KINDS = {  # kind, and whether it is convex where that matters
    "concave crossing": (CornerKind.CROSSING, 0.0),
    "convex crossing": (CornerKind.CROSSING, 1.0),
    "free end": (CornerKind.FREE_END, None),
    "jamb": (CornerKind.JAMB, None),
}
RECALLS = "`recall` counts detectable corners, `recall_rest` all others in line of sight (posts of doors among them)."
STAGES = ("sweeps", "clustering", "segments", "corners")


def run(options: Options) -> Figures:
    """Results of every preset and clustering threshold, from 80 poses per layout (8 with --quick)."""
    poses = 8 if options.quick else 80
    tasks = [(layout, poses) for layout in shipped_layouts()]
    of_layouts = in_parallel(score_layout, dict[str, list[Score]], tasks, options)
    scores = {name: [score for of_layout in of_layouts for score in of_layout[name]] for name in of_layouts[0]}
    return {
        "poses": poses * len(tasks),
        "presets": {key: summary(scores[key]) for key in map(key_of, PRESETS)},
        "layouts": {task[0]: rates(scores["paper K=4"]) for task, scores in zip(tasks, of_layouts, strict=True)},
        "thresholds": {
            key: {name: rates(scores[key if name == THRESHOLDS[0] else f"{key} {name}"]) for name in THRESHOLDS}
            for key in map(key_of, ABLATED)
        },
    }


def key_of(preset: Preset) -> str:
    """The name of a preset in the results."""
    return f"{preset[0]} K={preset[1]}"


def score_layout(task: tuple[str, int]) -> dict[str, list[Score]]:
    """Scores of the poses of one layout, for every preset and for the presets with varied thresholds."""
    places = make_places(*task, SEED, PRESETS)
    scores = {key_of(preset): score_places(places, preset, SlamConfig()) for preset in PRESETS}
    for preset in ABLATED:
        for name in THRESHOLDS[1:]:
            config = SlamConfig(clustering=threshold(name))
            scores[f"{key_of(preset)} {name}"] = score_places(places, preset, config)
    return scores


def threshold(name: str) -> ClusteringConfig:
    """The clustering configuration of an entry of THRESHOLDS."""
    if name.startswith("fixed_"):
        return ClusteringConfig(threshold="fixed", fixed_m=float(name.removeprefix("fixed_")))
    return ClusteringConfig.parse({"threshold": name})


def rates(scores: Sequence[Score]) -> Figures:
    """Precision, recall of detectable corners and of the rest, mean NIS, with intervals over poses."""
    rows = [score.table for score in scores]
    right = [r[r[:, 5] == 1.0] for r in rows]
    found, visible = np.array([s.found for s in scores]).T, np.array([s.visible for s in scores]).T
    return {
        "corners": sum(map(len, rows)),
        "precision": ratio(list(map(len, right)), list(map(len, rows))),
        "recall": ratio(found[0], visible[0]),
        "recall_rest": ratio(found[1], visible[1]),
        "NIS": ratio([r[:, 4].sum() for r in right], list(map(len, right))),
    }


def summary(scores: Sequence[Score]) -> Figures:
    """All results of one preset."""
    rows = np.concatenate([score.table for score in scores])
    right = rows[rows[:, 5] == 1.0]
    seconds, doors = (np.array([getattr(score, name) for score in scores]) for name in ("seconds", "doors"))
    us = 1e6 * np.median(np.column_stack([seconds, seconds.sum(axis=1)]), axis=0)
    return {
        **rates(scores),
        "rms_error_m": float(np.sqrt(np.mean(right[:, 3] ** 2))),
        "NIS_over_13.8": float(np.mean(right[:, 4] > 13.82)),
        "NIS_by_kind_and_range": {name: by_range(right[of_kind(right, *kind)]) for name, kind in KINDS.items()},
        "doors_found": ratio(doors[:, 1], doors[:, 0]),
        "false_doors": int(doors[:, 2].sum()),
        "us": dict(zip((*STAGES, "total"), us.tolist(), strict=True)),
    }


def of_kind(rows: Array, kind: CornerKind, convex: float | None) -> Array:
    """Which of the corners are of a kind."""
    return (rows[:, 0] == kind) & ((rows[:, 1] == convex) if convex is not None else True)


def by_range(right: Array) -> Figures:
    """Mean NIS per range bin."""
    inside = [(a, b, (right[:, 2] >= a) & (right[:, 2] < b)) for a, b in pairwise(RANGE_BINS_M)]
    return {f"{a:g}-{b:g} m": estimate(right[rows, 4]) for a, b, rows in inside}


def report(figures: Figures) -> str:
    """The page: presets, calibration, layouts, thresholds, times."""
    presets = figures["presets"]
    names = ("precision", "recall", "recall_rest", "rms_error_m", "NIS", "NIS_over_13.8", "doors_found", "false_doors")
    calibration = {name: of["NIS_by_kind_and_range"] for name, of in presets.items()}
    parts = {
        "Corners and doors": f"{RECALLS}\n\n{table_of('preset', names, presets)}",
        "Calibration: mean NIS by kind and range (2 expected)": one_table(calibration),
        "Layouts, paper K=4": one_table(figures["layouts"]),
        "Clustering thresholds": one_table(figures["thresholds"]),
        "Time, microseconds (median)": one_table({name: of["us"] for name, of in presets.items()}),
    }
    said = f"{figures['poses']} random poses in {', '.join(figures['layouts'])}; 95 % intervals over poses."
    return f"{said}\n\n{sections(parts)}"
