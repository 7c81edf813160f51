"""Tables of the site fit a window of 1280 px: how wide ones are split."""

import importlib
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("docutils")


def table_of(rows: list[list[str]]) -> Any:
    """A table of docutils in a document of its own."""
    from docutils import nodes
    from docutils.utils import new_document

    group = nodes.tgroup("", *(nodes.colspec(colwidth=1) for _ in rows[0]), cols=len(rows[0]))
    for part, lines in ((nodes.thead(), rows[:1]), (nodes.tbody(), rows[1:])):
        for line in lines:
            part += nodes.row("", *(nodes.entry("", nodes.paragraph("", "", nodes.Text(words))) for words in line))
        group += part
    document = new_document("test")
    document += nodes.table("", group)
    return document


def words(table: Any) -> list[list[str]]:
    from docutils import nodes

    def plain(entry: Any) -> str:
        return "".join(str(text) for text in entry.findall(nodes.Text) if not isinstance(text.parent, nodes.raw))

    return [[plain(entry) for entry in row.children] for row in table.findall(nodes.row)]


@pytest.mark.parametrize("columns", [2, 30])
def test_every_column_is_once_in_parts_that_fit(columns: int, monkeypatch: pytest.MonkeyPatch) -> None:
    from docutils import nodes

    monkeypatch.syspath_prepend(str(Path(__file__).parent.parent / "docs"))
    wide = importlib.import_module("wide_tables")
    rows = [[f"{kind}{k:02d}xxxxxx" for k in range(columns)] for kind in ("head", "body")]
    document = table_of(rows)
    wide.fit_tables(None, document)
    parts = list(document.findall(nodes.table))
    assert all(sum(wide.widths(part)) <= wide.CONTENT_PX for part in parts)
    assert (len(parts) > 1) == (columns > 8)
    shown = [words(part) for part in parts]
    assert all(line[0] == row[0] for part in shown for line, row in zip(part, rows, strict=True))
    assert [[cell for part in shown for cell in part[k][1:]] for k in range(2)] == [row[1:] for row in rows]
    for part in parts:
        (group,) = part.findall(nodes.tgroup)
        assert group["cols"] == len(list(part.findall(nodes.colspec))) == len(words(part)[0])
