"""Fields of the configuration and of messages, with the comments behind them in the source: unit and meaning."""

from __future__ import annotations

import ast
import functools
import inspect
import io
import textwrap
import tokenize
from collections.abc import Iterator, Sequence

from mecp_env.config import EnvConfig
from mecp_env.core.settings import Settings

Row = tuple[str, ...]


@functools.cache
def comments(owner: type) -> dict[str, str]:
    """The comment of each field of a class, inherited ones first; a comment may also fill the line above its field."""
    bases = [base for base in reversed(owner.__mro__) if base.__module__.startswith("mecp_env")]
    return {name: text for base in bases for name, text in own_comments(base).items()}


def own_comments(owner: type) -> dict[str, str]:
    """As `comments`, without inherited fields."""
    source = textwrap.dedent(inspect.getsource(owner))
    lines, body = source.splitlines(), ast.parse(source).body[0]
    assert isinstance(body, ast.ClassDef)
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    found = {token.start[0]: token.string.lstrip("# ") for token in tokens if token.type == tokenize.COMMENT}
    above = {row + 1: text for row, text in found.items() if lines[row - 1].lstrip().startswith("#")}
    fields = [node for node in body.body if isinstance(node, ast.AnnAssign)]
    texts = {ast.unparse(node.target): (above | found).get(node.lineno, "") for node in fields}
    return {name: text for name, text in texts.items() if not text.startswith("type: ")}


def table(head: Row, rows: Sequence[Row]) -> str:
    """A Markdown table."""
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines) + "\n"


def code(value: object) -> str:
    """A value as code."""
    return f"`{value!r}`"


def field_rows(section: type[Settings], prefix: str = "") -> Iterator[Row]:
    """Name, default and meaning of the fields of a section, without the sections in it."""
    for name, field in section.model_fields.items():
        default = field.get_default(call_default_factory=True)
        if not isinstance(default, Settings):
            yield f"`{prefix}{name}`", code(default), comments(section)[name]


def sections(section: type[Settings], prefix: str = "") -> Iterator[tuple[str, type[Settings]]]:
    """A section and those in it, with the prefix of their fields."""
    yield prefix, section
    for name, field in section.model_fields.items():
        if isinstance(field.default, Settings):
            yield from sections(type(field.default), f"{prefix}{name}.")


def configuration_page() -> str:
    """Every field of `EnvConfig`."""
    parts = [
        "# Configuration\n",
        "Every field of `EnvConfig` with its default. Fields are keywords of `gymnasium.make`: `laser.beams` is",
        '`laser={"beams": 360}`. On the command line it is `--config.laser.beams 360`.\n',
    ]
    for prefix, section in sections(EnvConfig):
        rows = list(field_rows(section, prefix))
        summary = (inspect.getdoc(section) or "").partition("\n\n")[0]
        if rows:
            title = f"## {prefix[:-1] or 'Top level'}\n"
            parts += [title, f"{summary}\n", table(("field", "default", "meaning"), rows)]
    return "\n".join(parts)
