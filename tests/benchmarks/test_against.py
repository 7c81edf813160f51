"""Comparisons with another commit: what is measured, what an error says, and that nothing is left behind."""

import tempfile
from pathlib import Path

import numpy as np
import pytest

from benchmarks import against, in_tree, start, trees
from benchmarks.common import Options
from benchmarks.tables import report_of
from benchmarks.trees import WORKING_TREE, TreeError, run_in
from mecp_env.planning.breadth_first import BreadthFirst


@pytest.mark.slow
@pytest.mark.skipif(not (WORKING_TREE / ".git").exists(), reason="not in a git clone")
def test_both_trees_drive_the_same_steps_and_the_copy_is_removed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(against.peers, "measure", lambda *given: {})  # test_times.py has them
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")  # the copy has no cache, and few steps
    for name, value in {"BLOCK": 1, "WARM_UP": 1, "BLOCKS": 1, "TURNS": 1}.items():
        monkeypatch.setattr(against, name, value)
    figures = against.run(Options(against="HEAD"))
    assert set(figures) == {"against", "K=1", "K=4", "peers"}
    for values in figures["K=1"].values():
        assert values["ratio"]["value"] > 0.0
        assert values["ratio"]["n"] == 1
        assert min(values["steps_per_s"], values["steps_per_s_against"]) > 0.0
        assert 0.0 <= values["same_observations"] <= 1.0
    assert all(f"| K=1, {actions} |" in against.report(figures) for actions in in_tree.ACTIONS)
    assert not list(tmp_path.iterdir())


def test_turns_in_which_everything_was_compiled_do_not_count() -> None:
    turns = [(10, 1.0, 2.0, "a"), (0, 0.0, 2.0, "b"), (10, 1.2, 2.4, "a")]
    pairs = [
        ({"steps": n, "seconds": new, "digest": "a"}, {"steps": 10, "seconds": old, "digest": digest})
        for n, new, old, digest in turns
    ]
    figures = against.summarise(pairs)
    assert figures["ratio"]["value"] == pytest.approx(0.5)
    assert figures["ratio"]["n"] == 2
    assert figures["steps_per_s"] == pytest.approx(10 / 1.1)
    assert figures["same_observations"] == pytest.approx(2 / 3)


def test_the_driver_chooses_as_the_breadth_first_explorer() -> None:
    rng, policy = np.random.default_rng(0), BreadthFirst()
    for _ in range(300):
        goals = rng.integers(0, 4, (32, 9)).astype(np.float32)
        goals[:, in_tree.PATH] = rng.uniform(0.5, 9.0, 32)
        goals[:, in_tree.VALID] = np.arange(32) < rng.integers(0, 33)
        mask = goals[:, in_tree.VALID] > 0.5
        assert in_tree.next_goal(goals, mask) == policy.act({"goals": goals}, mask)


def test_the_first_start_counts_the_files_of_an_empty_cache_and_what_fails_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    script = tmp_path / "script.py"
    script.write_text("import os, pathlib; pathlib.Path(os.environ['NUMBA_CACHE_DIR'], 'f.nbi').touch(); print('{}')")
    monkeypatch.setattr(trees, "SCRIPT", script)
    figures = start.run(Options(quick=True))
    assert figures["cache_files"] == 1
    assert figures["cpu_s"]["value"] > 0.0
    assert "| cache_files | 1 |" in report_of(figures)
    script.write_text("raise SystemExit('no such layout')")
    with pytest.raises(TreeError, match=r"(?s)script.py ended with exit code 1\nno such layout"):
        run_in(WORKING_TREE, "start")
    assert list(tmp_path.iterdir()) == [script]
