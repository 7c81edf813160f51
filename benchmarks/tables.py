"""Tables and sections of figures in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from mecp_env.policies.report_table import markdown_table

Rows = Mapping[str, Mapping[str, Any]]  # figures of each named row


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
