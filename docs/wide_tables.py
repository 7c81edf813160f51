"""Tables of the site fit a window of 1280 px: long names may break at their joints, wide tables become several."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from docutils import nodes

CONTENT_PX = 730.0  # the theme's column of text in a window of 1280 px
CELL_PX, LETTER_PX = 18.0, 8.5  # padding of a cell, width of a letter or digit in tables.css
LONG = 9  # letters of a word that may break
JOINT = re.compile(r"(?<=[_/.:=-])(?=[^\W\d])")  # not within a number
MARK = nodes.raw("", "<wbr>", format="html")


def fit_tables(app: Any, doctree: nodes.document) -> None:
    """Let long names break, and split the tables that are still too wide. A handler of `doctree-read`."""
    for table in list(doctree.findall(nodes.table)):
        for text in list(table.findall(nodes.Text)):
            text.parent.replace(text, list(broken(str(text))))
        if not any("morecols" in entry or "morerows" in entry for entry in table.findall(nodes.entry)):
            table.replace_self(split(table))


def broken(words: str) -> Iterator[nodes.Node]:
    """The text, with a place to break after each joint of a long word."""
    parts = [
        piece for word in re.split(r"(\s+)", words) for piece in (JOINT.split(word) if len(word) > LONG else [word])
    ]
    text = ""
    for part in parts:
        if text and not text[-1].isspace() and part and not part.isspace():
            yield nodes.Text(text)
            yield MARK.deepcopy()
            text = ""
        text += part
    yield nodes.Text(text)


def split(table: nodes.table) -> list[nodes.table]:
    """The table, or several with some of its columns each, all with the first column."""
    groups = column_groups(widths(table))
    return [table] if len(groups) == 1 else [with_columns(table, {0, *group}) for group in groups]


def column_groups(width: list[float]) -> list[list[int]]:
    """Columns after the first that fit beside it; as many in each group as there is space, one at least."""
    groups, used = [list[int]()], width[0]
    for column, px in enumerate(width[1:], 1):
        if groups[-1] and used + px > CONTENT_PX:
            groups, used = [*groups, []], width[0]
        groups[-1].append(column)
        used += px
    return groups


def widths(table: nodes.table) -> list[float]:
    """For each column the width of its longest piece that cannot break, px."""
    columns = zip(*(row.children for row in table.findall(nodes.row)), strict=True)
    return [CELL_PX + LETTER_PX * max(map(longest, column)) for column in columns]


def longest(entry: nodes.Node) -> int:
    """Letters of the longest piece of a cell."""
    return max((len(word) for text in entry.findall(nodes.Text) for word in str(text).split()), default=0)


def with_columns(table: nodes.table, columns: set[int]) -> nodes.table:
    """A copy with some columns."""
    part: nodes.table = table.deepcopy()
    (group,) = part.findall(nodes.tgroup)
    for row in [*part.findall(nodes.row), group]:
        cells = [child for child in row if isinstance(child, nodes.entry | nodes.colspec)]
        for number, cell in enumerate(cells):
            if number not in columns:
                row.remove(cell)
    group["cols"] = len(columns)
    return part
