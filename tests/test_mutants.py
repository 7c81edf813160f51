"""The mutants of `python -m tests.mutants`: which there are, and that each is another program of as many lines."""

import ast
from pathlib import Path

from tests.mutants import drawn, mutants

SOURCE = '''"""A module."""

def rule(a: float, b: int = 2) -> float:
    """Its text."""
    if not a or (
        b > 2
    ):
        raise ValueError(f"{a + b} > 2")
    return min(a, b) - 0.5
'''
EXPECTED = {
    "not a or b > 2 -> True",
    "not a or b > 2 -> False",
    "not a or b > 2 -> not a and b > 2",
    "not a or b > 2 -> b > 2",
    "not a or b > 2 -> not a",
    "not a -> a",
    "b > 2 -> b <= 2",
    "b > 2 -> b >= 2",
    "min(a, b) - 0.5 -> min(a, b) + 0.5",
    "min(a, b) -> max(a, b)",
    "0.5 -> 1.0",
}


def test_mutants_change_rules_and_neither_texts_nor_types(tmp_path: Path) -> None:
    path = tmp_path / "mecp_env/slam/module.py"
    path.parent.mkdir(parents=True)
    path.write_text(SOURCE)
    found = list(mutants(tmp_path))
    assert {mutant.name.partition(" rule: ")[2] for mutant in found} == EXPECTED
    for mutant in found:
        changed = SOURCE.encode()[: mutant.start] + mutant.text + SOURCE.encode()[mutant.end :]
        assert ast.dump(ast.parse(changed)) != ast.dump(ast.parse(SOURCE))
        assert changed.count(b"\n") == SOURCE.count("\n")
    assert drawn(tmp_path, 0) == drawn(tmp_path, 0) != drawn(tmp_path, 1)
