"""Figures of several runs as columns, their means and ratios with 95 % intervals, and tables of them in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.intervals import Figures, estimate, ratio
from mecp_env.policies.report import markdown_table

Rows = Mapping[str, Mapping[str, Any]]  # figures of each named row


def columns_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, Array]:
    """(n,) the values of each figure of n runs."""
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def by_row(runs: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """The results of each row in all runs; a row that a run lacks is left out."""
    return {name: [run[name] for run in runs] for name in runs[0] if all(name in run for run in runs)}


def means(columns: Mapping[str, Array], *names: str) -> Figures:
    """Means of some columns, each with its 95 % interval."""
    return {name: estimate(columns[name]) for name in names}


def ratios(columns: Mapping[str, Array], **pairs: str) -> Figures:
    """Ratios of sums of two columns with their 95 % intervals; each is given as `part/whole`."""
    return {name: ratio(*(columns[column] for column in pair.split("/"))) for name, pair in pairs.items()}


def precision_and_recall(columns: Mapping[str, Array]) -> Figures:
    """Both of the pairs that are right, wrong and missed, `tp`, `fp` and `fn`, with their 95 % intervals."""
    tp = columns["tp"]
    return {"precision": ratio(tp, tp + columns["fp"]), "recall": ratio(tp, tp + columns["fn"])}


VISIT_RATIOS = {  # figures of explorations that are a sum over a sum
    "contacts_per_100_m": "contacts_100/metres",
    "door_precision": "doors_found/all_doors_found",
    "door_recall": "doors_found/doors",
    "doors_false_per_10_true": "doors_false_10/doors",
    "doors_found": "doors_found/doors",
    "periods_per_m2": "periods/free_area_m2",
    "precision": "right/association_pairs",
    "room_precision": "rooms_found/all_rooms_found",
    "room_recall": "rooms_found/rooms",
    "rooms_found": "rooms_found/rooms",
    "rooms_left": "rooms/all_rooms",
}


def of_visits(finals: Sequence[Mapping[str, Any]], names: Sequence[str]) -> Figures:
    """Figures of explorations from their summaries: ratios of sums, or means, with their 95 % intervals."""
    of = columns_of(finals)
    of |= {"right": of["association_pairs"] - of["association_false"], "contacts_100": 100.0 * of["contacts"]}
    of |= {"all_rooms": of["rooms"] + of["rooms_cut_off"], "recall": of["association_recall"], "nees": of["nees_mean"]}
    of |= {f"all_{kind}_found": of[f"{kind}_found"] + of[f"{kind}_false"] for kind in ("rooms", "doors")}
    of |= {"doors_false_10": 10.0 * of["doors_false"]}
    return {
        name: ratios(of, **{name: VISIT_RATIOS[name]})[name] if name in VISIT_RATIOS else estimate(of[name])
        for name in names
    }


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table with formatted numbers and estimates."""
    return markdown_table(header, [[readable(cell) for cell in row] for row in rows])


def table_of(head: str, columns: Sequence[str], rows: Rows) -> str:
    """A table with the figures `columns` of each named row; what a row lacks is a dash."""
    cells = [[name, *(row.get(column, "-") for column in columns)] for name, row in rows.items()]
    return table([head, *columns], cells)


def turned(settings: Rows, titles: Sequence[str] = ()) -> str:
    """A table with a row for each figure and a column for each setting, whose heading is its name or title."""
    names = dict.fromkeys(name for figures in settings.values() for name in figures)
    rows = [(name.replace("_", " "), *(of.get(name, "-") for of in settings.values())) for name in names]
    return table(["", *(titles or settings)], rows)


def whole_rows(heads: Sequence[str], rows: Rows) -> str:
    """A table with all figures of each named row, below the given headings."""
    return table(heads, [(name, *row.values()) for name, row in rows.items()])


def sections(bodies: Mapping[str, str]) -> str:
    """The parts of a page below their titles."""
    return "\n\n".join(f"## {title}\n\n{body}" for title, body in bodies.items())


def listed(lines: Sequence[str], none: str) -> str:
    """Lines as a list; `none` without any."""
    return "\n".join(f"- {line}" for line in lines) or none


def readable(figure: object) -> str:
    """A figure as text: an estimate as `value [low, high]`."""
    if isinstance(figure, dict):
        if figure["value"] is None:
            return "none"
        return f"{readable(figure['value'])} [{readable(figure['low'])}, {readable(figure['high'])}]"
    if isinstance(figure, float):
        return f"{figure:,.0f}" if abs(figure) >= 1000.0 else f"{figure:.4g}"
    return str(figure)


def flatten(figures: Any, path: str = "") -> dict[str, Any]:
    """Path -> figure (a number, a text or an estimate)."""
    if not isinstance(figures, dict) or {"value", "low", "high"} <= figures.keys():
        return {path: figures}
    flat: dict[str, Any] = {}
    for name, inner in figures.items():
        flat |= flatten(inner, f"{path}/{name}" if path else str(name))
    return flat
