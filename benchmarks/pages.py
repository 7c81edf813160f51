"""Writes again what follows from the files of results: pages, tables of documents, reference rows of the package.

python -m benchmarks.pages
"""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path

from benchmarks import policy_tables
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
    for document in policy_tables.DOCUMENTS:
        document.write_text(policy_tables.updated(document.read_text(), policy_tables.tables()))
    for path, rows in policy_tables.reference_rows().items():
        path.write_text(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
