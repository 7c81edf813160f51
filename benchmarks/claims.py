"""Each claim of the paper as a row: the sentence, the experiment, the figure with its interval, whether it holds.

A claim holds ("yes") if the whole 95 % interval of its figure is on the right side of the bound, and does not ("no") if
the whole interval is on the other side; else it is "open". The bounds are ours: the paper states none. Figures come
from the functions of other benchmarks on fewer drives; their own pages have the larger samples.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks import association
from benchmarks.association import differences, summarise
from benchmarks.claim_units import PRESETS, SIGMAS, VARIANTS, measure, of_clustering, recalls
from benchmarks.common import Figures, Options, estimate, ratio
from benchmarks.features import key_of
from benchmarks.polygon_speed import exponents
from benchmarks.records import on_records
from benchmarks.rough_pose import named, right_share
from benchmarks.tables import all_figures, by_row, columns_of, flatten, readable, summary, table
from benchmarks.variants import LETTER
from mecp_env.world.layout import shipped_layouts

DRIVES = {"paper": 12, "furnished": 6}
LOOPS = {"paper": 6, "hard": 4}
POSES = 24  # per layout
SITES, SETS = (10, 15, 20, 30, 40), 100  # for the exponent of the cost
DENSE, SINGLE, IDEAL_DENSE, IDEAL_SINGLE = (key_of(preset) for preset in PRESETS)
IDEAL = {association.IDEAL: 12}
ROUGH, ROUGHEST = map(named, SIGMAS)
PAPER = "mecp_paper"


@dataclass(frozen=True, slots=True)
class Claim:
    """A sentence of the paper, and the figure that decides about it."""

    section: str
    sentence: str
    experiment: str
    figure: str  # keys joined by "/"
    at_least: float | None = None  # one of both bounds
    at_most: float | None = None
    beside: Sequence[str] = ()  # other figures that belong to it

    @property
    def bound(self) -> str:
        """The bound in signs."""
        return f">= {self.at_least:g}" if self.at_least is not None else f"<= {self.at_most:g}"

    def holds(self, figures: Figures) -> str:
        """yes, no or open; open also where nothing was measured."""
        found = flatten(figures).get(self.figure)
        low, high = (found["low"], found["high"]) if isinstance(found, dict) else (found, found)
        if low is None or high is None:
            return "open"
        if self.at_least is not None:
            right, wrong = low >= self.at_least, high < self.at_least
        else:
            right, wrong = high <= self.at_most, low > self.at_most
        return "yes" if right else "no" if wrong else "open"


CLAIMS = [Claim(**row) for row in tomllib.loads(Path(__file__).with_suffix(".toml").read_text())["claim"]]


def run(options: Options) -> Figures:
    """All figures that the claims name."""
    part = 6 if options.quick else 1
    units = [
        (kind, layout, seed)
        for kind, counts in {"drive": DRIVES, "ideal": IDEAL, "loop": LOOPS}.items()
        for layout, count in counts.items()
        for seed in range(max(count // part, 1))
    ]
    units += [("scans", layout, POSES // part) for layout in shipped_layouts()]
    of: dict[str, list[Any]] = {}
    for (kind, _), results in on_records(measure, dict[str, Any], units, options).items():
        of.setdefault(kind, []).extend(results)
    rough = of_loops(of["loop"])
    return {
        **of_drives([r["methods"] for r in of["drive"]]),
        "ideal_laser": precisions([r["methods"] for r in of["ideal"]]),
        **of_polygons([r["polygons"] for r in of["drive"]]),
        **rough,
        **of_scans(of["scans"]),
        "timed": {**rough["timed"], **exponents(SITES, SETS // part)},
    }


def of_drives(runs: list[dict[str, Figures]]) -> Figures:
    """Closed loop: precision, pairs across a wall, returns."""
    rows = {name: summarise(own) for name, own in by_row(runs).items()}
    alone = {"mecp": "mecp", "rooms_alone": "mecp without descriptor", "descriptor_alone": "mecp without rooms"}
    return {
        "closed_loop": precisions(runs),
        "across_a_wall": {key: rows[name]["swapped_per_1000"] for key, name in (alone | {"paper": PAPER}).items()},
        "revisiting": {
            **{key: rows["mecp"][key] for key in ("closure_recall", "false_closures", "events")},
            "paper_closure_recall": rows[PAPER]["closure_recall"],
        },
    }


def precisions(runs: list[dict[str, Figures]]) -> Figures:
    """How exact the paper's rule is beside others, on the same drives."""
    rows = by_row(runs)
    names = {"paper": PAPER, "letter": LETTER, "mecp": "mecp", "nearest": "nearest"}
    return {
        "paper_minus_nearest": differences(rows[PAPER], rows["nearest"])["precision_minus_mecp"],
        **{f"{key}_precision": summarise(rows[name])["precision"] for key, name in names.items()},
    }


def of_polygons(runs: list[Figures]) -> Figures:
    """What polygons are like."""
    of = columns_of(runs)
    parts = {"visible": "free/lines", "visible_without_check": "free_raw/lines_raw", "unique": "unique/found"}
    parts |= {"rooms_with_polygon": "rooms_with_polygon/rooms"}
    shares = {name: ratio(*(of[column] for column in pair.split("/"))) for name, pair in parts.items()}
    return {
        "kernel_rule": {name: ratio(of[name], of["searched"]) for name in ("lost", "none")},
        "variance": {"in_a_scan": estimate(of["share_in_scan"]), "in_the_map": estimate(of["share_in_map"])},
        "polygons": shares | summary(runs, ("cover", "grid_cover")),
    }


def of_loops(runs: list[dict[str, dict[str, Figures]]]) -> Figures:
    """One scan at a rough pose: what polygons gain, and what methods cost."""
    cells = {(name, sigma): of for name, own in by_row(runs).items() for sigma, of in by_row(own).items()}
    with_them, without, *_ = VARIANTS
    gain = [right_share(cells[with_them, sigma]) - right_share(cells[without, sigma]) for sigma in (ROUGH, ROUGHEST)]
    ms = {name: columns_of(cells[name, ROUGH])["ms"] for name in VARIANTS}
    return {
        "rough_pose": {
            "polygons_gain": estimate(gain[0]),
            "polygons_gain_roughest": estimate(gain[1]),
            "right": {name: summary(cells[name, ROUGH], ("right",))["right"] for name in VARIANTS},
        },
        "timed": {
            "paper_over_jcbb": ratio(ms[PAPER], ms["jcbb"]),
            "mecp_over_jcbb_with_descriptor": ratio(ms["mecp"], ms["jcbb with descriptor"]),
        },
    }


def of_scans(layouts: list[dict[str, dict[str, list[list[int]]]]]) -> Figures:
    """Recall of corners by sweeps and thresholds, for both readings of the laser's noise."""
    recall = {
        key: {name: recalls([counts for layout in layouts for counts in layout[key][name]]) for name in names}
        for key, names in layouts[0].items()
    }
    return {
        "clustering": of_clustering(recall[SINGLE], recall[DENSE]),
        "clustering_ideal": of_clustering(recall[IDEAL_SINGLE], recall[IDEAL_DENSE]),
    }


def report(figures: Figures) -> str:
    """One table of the claims, and one of all figures."""
    flat, rows = flatten(figures), []
    for claim in CLAIMS:
        beside = [f"{name.partition('/')[2]}: {readable(flat.get(name, '-'))}" for name in claim.beside]
        sentence = f'"{claim.sentence}" ({claim.section})'
        found, holds = flat.get(claim.figure, "-"), f"**{claim.holds(figures)}**"
        rows.append([sentence, claim.experiment, found, claim.bound, holds, "; ".join(beside)])
    header = ["claim", "experiment", "figure", "bound", "holds", "beside it"]
    return f"{table(header, rows)}\n\n## All figures\n\n{all_figures(figures)}"
