"""Reference rows of the frozen benchmarks, which the package contains: figures without episodes."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from mecp_env.core.errors import ConfigError
from mecp_env.core.intervals import estimate, share

FOLDER = Path(__file__).parent / "references"
SUFFIX = " (reference)"  # no other row can have it: parentheses are no part of a name
UNSAFE = re.compile(r"[^\w .,:/+@=-]")  # marks of Markdown, bars, line breaks, control characters, ...
LONGEST = 80  # characters of a name
SHARES = ("lost", "complete")
DIGITS = 4


def safe_name(name: str) -> str:
    """A name as a cell of a table shows it: one line, without characters that have a meaning in Markdown."""
    return UNSAFE.sub("?", name)[:LONGEST]


def check_name(name: str, field: str = "name") -> str:
    """`name` itself. Raises `ConfigError` for one that a table would not show as it is, or an empty one."""
    if not name.strip() or name != safe_name(name):
        raise ConfigError(
            f"{field}: {name!r:.100}, expected at most {LONGEST} letters, digits, spaces and _.,:/+@=- in one line"
        )
    return name


def reference_rows(suite: str, frozen: str) -> list[dict[str, Any]]:
    """The rows of a suite with that hash, as the results of a file; none where the package has none."""
    path = FOLDER / f"{suite}.json"
    content = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    return list(content["results"]) if content.get("hash") == frozen else []


def rows_of_references(
    submissions: Iterable[Mapping[str, Any]], first: int, tasks: Sequence[str]
) -> list[dict[str, Any]]:
    """The rows of references, from results of submissions: the first so many buildings of those tasks.

    So a result of a large suite gives the row of a smaller one whose buildings are the first of the same.
    """
    return [
        {"task": row["task"], "policy": row["policy"], "estimator": row["estimator"], "figures": compact(row, first)}
        | {name: content[name] for name in ("hours", "seeds") if content.get(name) is not None}
        for content in submissions
        for row in content["results"]
        if row["task"] in tasks and len(row["episodes"]) >= first
    ]


def compact(row: Mapping[str, Any], first: int) -> dict[str, dict[str, float]]:
    """The figures of the first episodes of a row, with few digits."""
    episodes = sorted(row["episodes"], key=lambda episode: episode["building"])[:first]
    figures = {}
    for name in row["figures"]:
        values = [episode[name] for episode in episodes]
        found = share(value > 0.5 for value in values) if name in SHARES else estimate(values)
        figures[name] = {end: round(found[end], DIGITS) for end in ("value", "low", "high")}
    return figures
