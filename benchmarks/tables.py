"""Tables and pages of figures in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from mecp_env.policies.report import markdown_table


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table with formatted numbers and estimates."""
    return markdown_table(header, [[readable(cell) for cell in row] for row in rows])


def table_of(head: str, columns: Sequence[str], rows: Mapping[str, Mapping[str, object]]) -> str:
    """A Markdown table with the figures `columns` of each named row; what a row lacks is a dash."""
    cells = [[name, *(row.get(column, "-") for column in columns)] for name, row in rows.items()]
    return table([head, *columns], cells)


def page(doc: str | None, *parts: str) -> str:
    """The paragraphs of a module's docstring after the first, and the parts of a page."""
    return "\n\n".join([str(doc).partition("\n\n")[2].strip(), *parts])


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
