"""Writes the page of every result again, from its file: `python -m benchmarks.pages`."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path

from benchmarks.common import RESULTS, page_of


def pages() -> Iterator[tuple[Path, str]]:
    """Each file of results of a benchmark, and the page that belongs to it."""
    for path in sorted(RESULTS.glob("*.json")):
        content = json.loads(path.read_text())
        if "benchmark" in content:  # other results are those of `mecp-env evaluate`
            name = "against" if "against" in content["figures"] else content["benchmark"]
            yield path, page_of(content, importlib.import_module(f"benchmarks.{name}"), f"{path.stem}.png")


def main() -> int:
    """Write them."""
    for path, page in pages():
        path.with_suffix(".md").write_text(page)
    return 0


if __name__ == "__main__":
    sys.exit(main())
