"""Figures of several runs with their 95 % intervals, each defined once for all benchmarks, and tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.intervals import Figures, estimate, ratio, share
from mecp_env.policies.report import markdown_table

Rows = Mapping[str, Mapping[str, Any]]  # figures of each named row

RATIOS = {  # figures that are a sum over a sum, where the runs have both
    "after_door_wrong": "after_door_wrong/after_door",
    "budget_spent": "budget_spent/scans",
    "by_polygon": "paired/seen",
    "closure_recall": "closed/events",
    "contacts_per_100_m": "contacts_100/metres",
    "door_precision": "doors_found/all_doors_found",
    "door_recall": "doors_found/doors",
    "doors_false_per_10_true": "doors_false_10/doors",
    "doors_found": "doors_found/doors",
    "duplicates_per_corner": "duplicates/mapped",
    "false_closures": "false_closures/events",
    "periods_per_m2": "periods/free_area_m2",
    "phantoms": "phantoms/far",
    "precision": "tp/tp+fp",
    "recall": "tp/tp+fn",
    "room_precision": "rooms_found/all_rooms_found",
    "room_recall": "rooms_found/rooms",
    "rooms_found": "rooms_found/rooms",
    "rooms_left": "rooms/all_rooms",
    "swapped_per_1000": "swapped/thousands",
    "unique": "unique/found",
    "wrong": "wrong/pairs",
    "wrong_per_1000": "fp/thousands",
    **{name: f"{name}/scans" for name in ("found", "polygon", "possible", "recognised", "right")},
}
SHARES = ("lost", "complete", "seen", "stuck", "early", "reached_90%", "reached_99%")  # of the runs
MOST_COLUMNS = 15  # of a table with a row for each name
SUMS = {"wrong_pairs": "wrong"} | {name: name for name in ("events", "far", "scans")}  # figure -> what is counted


def columns_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, Array]:
    """(n,) the values of each figure of n runs."""
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def by_row(runs: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """The results of each row in all runs; a row that a run lacks is left out."""
    return {name: [run[name] for run in runs] for name in runs[0] if all(name in run for run in runs)}


def summary(runs: Sequence[Mapping[str, Any]], names: Iterable[str]) -> Figures:
    """Some figures of n runs: ratios of sums, shares of the runs and means, with 95 % intervals, and numbers in all."""
    columns = columns_of(runs)
    return {name: _figure(columns, name) for name in names}


def summaries(rows: Mapping[str, Sequence[Mapping[str, Any]]], names: Iterable[str]) -> dict[str, Figures]:
    """`summary` of the runs of each row."""
    return {name: summary(runs, names) for name, runs in rows.items()}


def _figure(columns: Mapping[str, Array], name: str) -> Any:
    part, *wholes = RATIOS.get(name, name).replace("/", "+").split("+")
    if wholes and columns.keys() >= {part, *wholes}:
        return ratio(columns[part], sum(columns[whole] for whole in wholes))
    if name in SUMS:
        return int(columns[SUMS[name]].sum())
    return share(columns[name] > 0.5) if name in SHARES else estimate(columns[name])


def of_visits(finals: Sequence[Mapping[str, Any]], names: Iterable[str]) -> Figures:
    """`summary` of explorations, from the summaries of their episodes."""
    return summary([{**final, **_further(final)} for final in finals], names)


def _further(final: Mapping[str, Any]) -> dict[str, float]:
    """Sums of a summary that ratios need, and other names."""
    further = {f"all_{kind}_found": final[f"{kind}_found"] + final[f"{kind}_false"] for kind in ("rooms", "doors")}
    return further | {
        "tp": final["association_pairs"] - final["association_false"],
        "fp": final["association_false"],
        "recall": final["association_recall"],
        "contacts_100": 100.0 * final["contacts"],
        "all_rooms": final["rooms"] + final["rooms_cut_off"],
        "nees": final["nees_mean"],
        "doors_false_10": 10.0 * final["doors_false"],
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


def report_of(figures: Mapping[str, Any]) -> str:
    """Tables of nested figures: a row for each path of names, in a section named by all but the last of them."""
    if any(map(is_figure, figures.values())):
        return all_figures(figures)
    tables: dict[str, dict[str, Any]] = {}
    for (*names, last), row in rows_in(figures):
        tables.setdefault(", ".join(names), {})[last] = row
    parts = {f"{title}{runs_of(rows)}": grid(rows) for title, rows in tables.items() if title}
    return "\n\n".join(filter(None, (grid(tables.get("", {})), sections(parts))))


def one_table(figures: Mapping[str, Any]) -> str:
    """A table of nested figures with a row for each path of names."""
    return grid({", ".join(path): row for path, row in rows_in(figures)})


def rows_in(figures: Mapping[str, Any], path: Sequence[str] = ()) -> Iterator[tuple[Sequence[str], Figures]]:
    """The path of names to each row, and its figures."""
    own = {name: of for name, of in figures.items() if is_figure(of)}
    if own:
        yield path, own
    for name in figures:
        if name not in own:
            yield from rows_in(figures[name], (*path, name))


def runs_of(rows: Rows) -> str:
    """The number of runs for a title, where all estimates have the same."""
    counts = {figure["n"] for row in rows.values() for figure in row.values() if isinstance(figure, dict)}
    return f" (n = {counts.pop()})" if len(counts) == 1 else ""


def grid(rows: Rows) -> str:
    """A table with all figures of each named row; with many figures, each of them is a row."""
    columns = list(dict.fromkeys(name for row in rows.values() for name in row))
    if len(columns) > MOST_COLUMNS:
        return turned(rows)
    return table_of("", columns, rows) if rows else ""


def all_figures(figures: Mapping[str, Any]) -> str:
    """One table of all figures."""
    return table(["figure", "value [95 % interval]"], flatten(figures).items())


def sections(bodies: Mapping[str, str]) -> str:
    """The parts of a page below their titles."""
    return "\n\n".join(f"## {title}\n\n{body}" for title, body in bodies.items())


def readable(figure: object) -> str:
    """A figure as text: an estimate as `value [low, high]`."""
    if isinstance(figure, dict):
        if figure["value"] is None:
            return "none"
        return f"{readable(figure['value'])} [{readable(figure['low'])}, {readable(figure['high'])}]"
    if isinstance(figure, float):
        return f"{figure:,.0f}" if abs(figure) >= 1000.0 else f"{figure:.4g}"
    return str(figure)


def is_figure(found: Any) -> bool:
    """Whether something is a figure (a number, a text or an estimate), not figures by name."""
    return not isinstance(found, dict) or {"value", "low", "high"} <= found.keys()


def flatten(figures: Any, path: str = "") -> dict[str, Any]:
    """Path -> figure."""
    if is_figure(figures):
        return {path: figures}
    flat: dict[str, Any] = {}
    for name, inner in figures.items():
        flat |= flatten(inner, f"{path}/{name}" if path else str(name))
    return flat
