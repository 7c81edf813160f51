"""Each claim of the paper as a row: the sentence, the experiment, the figure with its interval, whether it holds.

A claim holds ("yes") if the whole 95 % interval of its figure is on the right side of the bound, and does not ("no") if
the whole interval is on the other side; else it is "open". The bounds are ours: the paper states none. Figures come
from the functions of other benchmarks on fewer drives; their own pages have the larger samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from benchmarks import association, claim_units
from benchmarks.association import LETTER, differences, summarise
from benchmarks.claim_units import PRESETS, SIGMAS, THRESHOLDS, UNION, VARIANTS, measure
from benchmarks.columns import columns_of, means, ratios
from benchmarks.common import Figures, Gate, Options, in_parallel
from benchmarks.features import key_of
from benchmarks.loop import figures_of, named
from benchmarks.polygon_speed import by_bearing, convex, median_us, search, uniform
from benchmarks.records import Records
from benchmarks.tables import flatten, page, readable, table
from mecp_env.core.intervals import estimate, ratio
from mecp_env.world.layout import shipped_layouts

DRIVES = {"paper": 12, "furnished": 6}
LOOPS = {"paper": 6, "hard": 4}
POSES = 24  # per layout
KINDS = ("drive", "ideal", "loop", "scans")
SITES, SETS, GROUPS = (10, 15, 20, 30, 40), 100, 5  # for the exponent of the cost
DENSE, SINGLE, IDEAL_DENSE, IDEAL_SINGLE = (key_of(preset) for preset in PRESETS)
IDEAL = {association.IDEAL: 12}
ROUGH, ROUGHEST = (named(sigma) for sigma in SIGMAS)

GATES = (
    Gate("variance/in_a_scan", "error", 1.2),
    Gate("revisiting/closure_recall", "share", 0.05),
    Gate("polygons/visible", "share", 0.01),
    Gate("polygons/cover", "share", 0.03),
    Gate("clustering/mean_minus_single", "share", 0.02),
)


@dataclass(frozen=True, slots=True)
class Claim:
    """A sentence of the paper, and the figure that decides about it."""

    section: str
    sentence: str
    experiment: str
    figure: str  # keys joined by "/"
    above: bool  # the bound is the least, not the most
    bound: float
    beside: tuple[str, ...] = ()  # other figures that belong to it

    def holds(self, figures: Figures) -> str:
        """yes, no or open; open also where nothing was measured."""
        found = flatten(figures).get(self.figure)
        low, high = (found["low"], found["high"]) if isinstance(found, dict) else (found, found)
        if low is None or high is None:
            return "open"
        sides = (low >= self.bound, high < self.bound) if self.above else (high <= self.bound, low > self.bound)
        return "yes" if sides[0] else "no" if sides[1] else "open"


MUCH_LOWER = "the variance of the resulting MoG is much lower than the variance of the individual vertices"
CLAIMS = (
    Claim(
        "III-B",
        MUCH_LOWER,
        "variance of a polygon's centre over the mean variance of its vertices, in one scan",
        *("variance/in_a_scan", False, 0.5),
    ),
    Claim(
        "III-B",
        MUCH_LOWER,
        "the same for the polygons of the final map, whose vertices share the error of the pose (eq. 3)",
        *("variance/in_the_map", False, 0.5),
    ),
    Claim(
        "III-B",
        "This representation allows a very efficient way of associating data",
        f"time of `mecp_paper` over that of `jcbb` without descriptors, {ROUGH}",
        *("timed/paper_over_jcbb", False, 1.0),
        ("timed/mecp_over_jcbb_with_descriptor",),
    ),
    Claim(
        "I",
        "The low variance of the mean of the polygon assists in improving the feature association",
        f"share of right scans with polygons beside cliques minus cliques alone, {ROUGH} (`loop`)",
        *("rough_pose/polygons_gain", True, 0.01),
        ("rough_pose/polygons_gain_roughest",),
    ),
    Claim(
        "V",
        "to increase the efficiency and the accuracy of data association",
        "precision of `mecp_paper`, the rule as written, minus that of `nearest`, in closed loop",
        *("closed_loop/paper_minus_nearest", True, 0.0),
        ("closed_loop/paper_precision", "closed_loop/letter_precision", "closed_loop/mecp_precision"),
    ),
    Claim(
        "V",
        "to increase the efficiency and the accuracy of data association",
        "the same with an ideal laser, whose noise only the filter assumes (IV)",
        *("ideal_laser/paper_minus_nearest", True, 0.0),
        ("ideal_laser/paper_precision", "ideal_laser/letter_precision", "ideal_laser/mecp_precision"),
    ),
    Claim(
        "IV",
        "two very close features separated by a wall are not mismatched to one another",
        "such pairs per 1,000 corners with `mecp`: different rooms, less than 0.4 m apart",
        *("across_a_wall/mecp", False, 1.0),
    ),
    Claim(
        "IV",
        "Because of the hierarchical room based matching",
        "the same with rooms, but without descriptors",
        *("across_a_wall/rooms_alone", False, 1.0),
        ("across_a_wall/descriptor_alone", "across_a_wall/paper"),
    ),
    Claim(
        "Abstract",
        "especially effective for association when revisiting previously mapped regions efficiently",
        "share of returns to a room that end with right pairs and no wrong one, `mecp`",
        *("revisiting/closure_recall", True, 0.95),
        ("revisiting/false_closures", "revisiting/paper_closure_recall"),
    ),
    Claim(
        "III-A.1",
        "a continuous dense representation improved the clustering",
        "recall of corners with the union of four sweeps minus with one sweep, threshold as written, same poses",
        *("clustering/union_minus_single", True, 0.0),
        ("clustering/union_with_noise_minus_single", "clustering_ideal/union_minus_single"),
    ),
    Claim(
        "III-A.1",
        "a continuous dense representation improved the clustering",
        "the same with the mean of four sweeps per bearing, our reading, and a noise term",
        *("clustering/mean_minus_single", True, 0.0),
        ("clustering_ideal/mean_minus_single",),
    ),
    Claim(
        "III-A.1",
        "a clustering method that clusters data on the basis of an adaptive threshold",
        "recall with the threshold as written minus that of the best fixed one, one sweep, noise on every beam",
        *("clustering/adaptive_minus_fixed", True, 0.0),
        ("clustering/with_noise_minus_fixed",),
    ),
    Claim(
        "III-A.1",
        "a clustering method that clusters data on the basis of an adaptive threshold",
        "the same with an ideal laser, whose noise only the filter assumes (IV)",
        *("clustering_ideal/adaptive_minus_fixed", True, 0.0),
        ("clustering_ideal/with_noise_minus_fixed",),
    ),
    Claim(
        "III-A.2",
        "For each p such that the kernel of P_p includes the robot position",
        "share of scans whose largest polygon has fewer vertices under this rule, or is lost, than without it",
        *("kernel_rule/lost", False, 0.01),
        ("kernel_rule/none",),
    ),
    Claim(
        "III-A.2",
        "guarantees the visibility of all its vertices as long as the robot is within the MECP",
        "free lines from random points of a scan's polygon to its vertices",
        *("polygons/visible", True, 0.99),
        ("polygons/visible_without_check",),
    ),
    Claim(
        "III-B",
        "there is no region of the room that is not occupied",
        "share of the free area under polygons after the exploration",
        *("polygons/cover", True, 0.99),
        ("polygons/rooms_with_polygon", "polygons/grid_cover"),
    ),
    Claim(
        "III-A.2",
        "we attempt to find a unique polygon",
        "share of scans with a single polygon of most vertices",
        *("polygons/unique", True, 0.95),
    ),
    Claim(
        "III-A.2",
        "The complexity of the entire algorithm is O(n^2)",
        "exponent of the time in the number of sites, 10 to 40, anywhere in a square",
        *("timed/exponent_uniform", False, 2.0),
        ("timed/exponent_convex",),
    ),
)


def run(options: Options) -> Figures:
    """All figures that the claims name."""
    part = 6 if options.quick else 1
    units = [
        *(("drive", layout, seed) for layout, n in DRIVES.items() for seed in range(max(n // part, 1))),
        *(("ideal", layout, seed) for layout, n in IDEAL.items() for seed in range(max(n // part, 1))),
        *(("loop", layout, seed) for layout, n in LOOPS.items() for seed in range(max(n // part, 1))),
        *(("scans", layout, POSES // part) for layout in shipped_layouts()),
    ]
    results = in_parallel(partial(measure, records=Records(options.records)), dict[str, Any], units, options)
    of = {kind: [r for u, r in zip(units, results, strict=True) if u[0] == kind] for kind in KINDS}
    closed, rough = of_drives([r["methods"] for r in of["drive"]]), of_loops(of["loop"])
    timed = {**rough.pop("timed"), **exponents(SETS // part)}
    return {
        **closed,
        "ideal_laser": precisions([r["methods"] for r in of["ideal"]]),
        **of_polygons([r["polygons"] for r in of["drive"]]),
        **rough,
        **of_scans(of["scans"]),
        "timed": timed,
    }


def of_drives(runs: list[dict[str, Figures]]) -> Figures:
    """Closed loop: precision, pairs across a wall, returns."""
    rows = {name: summarise([run[name] for run in runs]) for name in claim_units.METHODS}
    return {
        "closed_loop": precisions(runs),
        "across_a_wall": {
            "mecp": rows["mecp"]["swapped_per_1000"],
            "rooms_alone": rows["mecp without descriptor"]["swapped_per_1000"],
            "descriptor_alone": rows["mecp without rooms"]["swapped_per_1000"],
            "paper": rows["mecp_paper"]["swapped_per_1000"],
        },
        "revisiting": {
            "closure_recall": rows["mecp"]["closure_recall"],
            "false_closures": rows["mecp"]["false_closures"],
            "paper_closure_recall": rows["mecp_paper"]["closure_recall"],
            "events": rows["mecp"]["events"],
        },
    }


def precisions(runs: list[dict[str, Figures]]) -> Figures:
    """How exact the paper's rule is beside others, on the same drives."""
    precision = {name: summarise([run[name] for run in runs])["precision"] for name in claim_units.METHODS}
    pairs = differences([(run["mecp_paper"], run["nearest"]) for run in runs])
    return {
        "paper_minus_nearest": pairs["precision_minus_mecp"],
        "paper_precision": precision["mecp_paper"],
        "letter_precision": precision[LETTER],
        "mecp_precision": precision["mecp"],
        "nearest_precision": precision["nearest"],
    }


def of_polygons(runs: list[Figures]) -> Figures:
    """What polygons are like."""
    of = columns_of(runs)
    return {
        "kernel_rule": ratios(of, lost="lost/searched", none="none/searched"),
        "variance": {"in_a_scan": estimate(of["share_in_scan"]), "in_the_map": estimate(of["share_in_map"])},
        "polygons": {
            **ratios(of, visible="free/lines", visible_without_check="free_raw/lines_raw", unique="unique/found"),
            **means(of, "cover", "grid_cover"),
            **ratios(of, rooms_with_polygon="rooms_with_polygon/rooms"),
        },
    }


def of_loops(runs: list[dict[str, dict[str, Figures]]]) -> Figures:
    """One scan at a rough pose: what polygons gain, and what methods cost."""
    names = (VARIANTS[0], VARIANTS[1])
    right = {
        (name, s): np.array([run[name][s]["right"] / run[name][s]["scans"] for run in runs])
        for name in names
        for s in (ROUGH, ROUGHEST)
    }
    ms = {name: np.array([run[name][ROUGH]["ms"] for run in runs]) for name in VARIANTS}
    return {
        "rough_pose": {
            "polygons_gain": estimate(right[names[0], ROUGH] - right[names[1], ROUGH]),
            "polygons_gain_roughest": estimate(right[names[0], ROUGHEST] - right[names[1], ROUGHEST]),
            "right": {name: figures_of([run[name][ROUGH] for run in runs])["right"] for name in VARIANTS},
        },
        "timed": {
            "paper_over_jcbb": ratio(ms["mecp_paper"], ms["jcbb"]),
            "mecp_over_jcbb_with_descriptor": ratio(ms["mecp"], ms["jcbb with descriptor"]),
        },
    }


def of_scans(layouts: list[dict[str, dict[str, list[list[int]]]]]) -> Figures:
    """Recall of corners by sweeps and thresholds, for both readings of the laser's noise."""
    recall = {
        key_of(preset): {
            name: recalls([counts for layout in layouts for counts in layout[key_of(preset)][name]]) for name in names
        }
        for preset, names in PRESETS.items()
    }
    return {
        "clustering": of_clustering(recall[SINGLE], recall[DENSE]),
        "clustering_ideal": of_clustering(recall[IDEAL_SINGLE], recall[IDEAL_DENSE]),
    }


def of_clustering(single: dict[str, Any], dense: dict[str, Any]) -> Figures:
    """Recall with one sweep and with four, by threshold; differences at the same poses."""
    fixed = max((name for name in THRESHOLDS if name.startswith("fixed")), key=lambda n: np.nanmean(single[n]))
    return {
        "union_minus_single": estimate(dense["adaptive" + UNION] - single["adaptive"]),
        "union_with_noise_minus_single": estimate(dense["adaptive_noise" + UNION] - single["adaptive_noise"]),
        "mean_minus_single": estimate(dense["adaptive_noise"] - single["adaptive_noise"]),
        "adaptive_minus_fixed": estimate(single["adaptive"] - single[fixed]),
        "with_noise_minus_fixed": estimate(single["adaptive_noise"] - single[fixed]),
        "best_fixed": fixed,
        "recall": {name: estimate(values) for name, values in single.items()},
        "recall_dense": {name: estimate(values) for name, values in dense.items()},
    }


def recalls(counts: Sequence[Sequence[int]]) -> Any:
    """(n,) recall at each pose; nan where no corner is visible."""
    _, _, found, visible = np.array(counts, float).T
    return np.where(visible > 0, found / np.maximum(visible, 1.0), np.nan)


def exponents(sets: int) -> Figures:
    """Slope of log time over log sites of the polygon search, with the spread over groups of sets of sites."""
    return {f"exponent_{make.__name__}": estimate(slopes(make, sets)) for make in (uniform, convex)}


def slopes(make: Any, sets: int) -> list[float]:
    """The slope in each group."""
    items = {n: [by_bearing(points) for points in make(n, sets)] for n in SITES}
    groups = [[median_us(search, items[n][k::GROUPS]) for n in SITES] for k in range(GROUPS)]
    return [float(np.polyfit(np.log(SITES), np.log(group), 1)[0]) for group in groups]


def report(figures: Figures) -> str:
    """One table of the claims, and one of all figures."""
    flat, rows = flatten(figures), []
    for claim in CLAIMS:
        beside = [f"{name.partition('/')[2]}: {readable(flat.get(name, '-'))}" for name in claim.beside]
        bound = f"{'>=' if claim.above else '<='} {claim.bound:g}"
        sentence = f'"{claim.sentence}" ({claim.section})'
        found, holds = flat.get(claim.figure, "-"), f"**{claim.holds(figures)}**"
        rows.append([sentence, claim.experiment, found, bound, holds, "; ".join(beside)])
    header = ["claim", "experiment", "figure", "bound", "holds", "beside it"]
    every = table(["figure", "value [95 % interval]"], flat.items())
    return page(__doc__, table(header, rows), "## All figures", every)
