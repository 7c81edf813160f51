"""The rules of the source tree: few files at the root, no import cycles, bounded functions (CONTRIBUTING.md)."""

from __future__ import annotations

import pytest

from tests.architecture import TREES, figures, imports, levels

MOST = {
    "files at the root": 8,
    "import levels": 11,
    "files to change corner extraction": 9,
}


@pytest.mark.parametrize("what", MOST)
def test_the_tree_keeps_its_bounds(what: str) -> None:
    assert figures()[what] <= MOST[what]


@pytest.mark.parametrize("tree", TREES)
def test_no_import_cycles(tree: str) -> None:
    assert levels(imports(tree)) >= 1  # raises ValueError that names the cycle
