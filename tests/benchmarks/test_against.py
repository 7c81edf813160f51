"""Comparisons with another commit: what is measured, what an error says, and that nothing is left behind."""

import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

from benchmarks import against, in_tree, start
from benchmarks.common import Options
from benchmarks.trees import WORKING_TREE, TreeError, tree_worker
from mecp_env.planning.breadth_first import BreadthFirst

needs_git = pytest.mark.skipif(not (WORKING_TREE / ".git").exists(), reason="not in a git clone")


@pytest.fixture
def temporary(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


@pytest.mark.slow
@needs_git
def test_both_trees_drive_the_same_steps_and_the_copy_is_removed(
    temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = list[tuple[int, tuple[int, ...]]]()
    monkeypatch.setattr(against.peers, "measure", lambda *given: asked.append(given) or {})  # test_peers.py has them
    monkeypatch.setattr(against, "SWEEPS", (1,))
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")  # the copy has no cache, and few steps
    for name, value in {"BLOCK": 2, "WARM_UP": 1, "BLOCKS": 2}.items():
        monkeypatch.setattr(against, name, value)
    figures = against.run(Options(against="HEAD"))
    assert set(figures) == {"against", "K=1", "peers"}
    assert asked == [(2, (1,))]
    for values in figures["K=1"].values():
        assert values["ratio"]["value"] > 0.0
        assert min(values["steps_per_s"], values["steps_per_s_against"]) > 0.0
        assert 0.0 <= values["same_observations"] <= 1.0
    by_velocities = figures["K=1"]["random"]
    assert by_velocities["ratio"]["n"] + by_velocities["left_out"] == 2  # a goal may take all of the steps
    page = against.report(figures)
    assert all(f"| K=1 | {actions} |" in page for actions in against.ACTIONS)
    assert not list(temporary.iterdir())


def test_a_worker_that_dies_is_named_with_what_it_wrote() -> None:
    with (
        tree_worker("old tree", WORKING_TREE, "backwards", "1") as worker,
        pytest.raises(TreeError, match=r"(?s)old tree: the worker ended with exit code 1\n.*KeyError: 'backwards'"),
    ):
        worker.call("drive", 1)


def block(seconds: float, *, compiled: bool = False, digest: str = "a") -> dict[str, object]:
    return {"steps": 10, "seconds": seconds, "compiled": compiled, "digest": digest}


def test_blocks_with_a_compilation_do_not_count() -> None:
    pairs = [(block(1.0), block(2.0)), (block(9.0, compiled=True), block(2.0, digest="b")), (block(1.2), block(2.4))]
    figures = against.summarise(pairs)
    assert figures["ratio"]["value"] == pytest.approx(0.5)
    assert figures["ratio"]["n"] == 2
    assert figures["left_out"] == 1
    assert figures["steps_per_s"] == pytest.approx(10 / 1.1)
    assert figures["steps_per_s_against"] == pytest.approx(10 / 2.2)
    assert figures["same_observations"] == pytest.approx(2 / 3)


def test_the_driver_chooses_as_the_breadth_first_explorer() -> None:
    rng, policy = np.random.default_rng(0), BreadthFirst()
    for _ in range(300):
        goals = rng.integers(0, 4, (32, 9)).astype(np.float32)
        goals[:, in_tree.PATH] = rng.uniform(0.5, 9.0, 32)
        goals[:, in_tree.VALID] = np.arange(32) < rng.integers(0, 33)
        mask = goals[:, in_tree.VALID] > 0.5
        assert in_tree.breadth_first(goals, mask) == policy.act({"goals": goals}, mask)


def test_the_first_start_counts_the_files_of_an_empty_cache(monkeypatch: pytest.MonkeyPatch, temporary: Path) -> None:
    code = "import os, pathlib; pathlib.Path(os.environ['NUMBA_CACHE_DIR'], 'f.nbi').touch(); print('hello')"
    monkeypatch.setattr(start, "command", lambda mode: [sys.executable, "-c", code])
    figures = start.run(Options(quick=True))
    assert figures["cache_files"] == 1
    assert figures["cpu_s"]["value"] > 0.0
    assert "| working tree |" in start.report(figures)
    monkeypatch.setattr(start, "command", lambda mode: [sys.executable, "-c", "raise SystemExit('no such layout')"])
    with pytest.raises(TreeError, match=r"(?s)old: the first start failed.*no such layout"):
        start.first_start("old", WORKING_TREE)
    assert not list(temporary.iterdir())
