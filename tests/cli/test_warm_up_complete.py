"""After `mecp-env warmup` other commands compile next to nothing.

What other tests compiled counts as compiled ahead, so `.ci/run` runs this file before them, with an empty cache.
"""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import pytest

from mecp_env.cli import main as cli
from mecp_env.cli import warmup
from mecp_env.core import jit, warm_up
from tests.command_lines import ROOT

LINES = (  # as in the documents, shorter
    "doctor --seconds 1",
    "demo --layout paper --config.laser.preset urg04lx --config.odometry.preset turtlebot --config.max-steps 150",
    "explore gain --layout hard:7 --steps 60",
    "explore next_best_view --difficulty easy --estimator truth --steps 60 --replay page",
    "one-scan --step 6 --out scan",
    "worlds convert runs/paper-0/belief.yaml plan.json",
)
FEW = 3  # functions, each for one set of types, that all commands together may compile later


@pytest.mark.slow
@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_the_documented_commands_compile_next_to_nothing_after_a_warm_up(tmp_path: Path) -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT), "MECP_ENV_WARM_UP": "0"}

    def compiled_by(line: str) -> set[str]:
        """The functions in the cache after a command."""
        words = [sys.executable, "-m", "mecp_env", *line.split()]
        subprocess.run(words, cwd=tmp_path, env=environment, check=True, capture_output=True, timeout=900)
        return {path.name for path in jit.cache_directory().rglob("*.nbc")}

    warm = compiled_by("warmup")
    assert len(warm) > 200
    with ThreadPoolExecutor(2) as two:
        later = set.union(*two.map(compiled_by, LINES)) - warm
    assert len(later) <= FEW, sorted(later)


@pytest.mark.parametrize(
    ("jobs", "rows"),
    [("1", [("episode",), ("log",), ("tasks",)]), ("2", [("episode",), ("log", "tasks")])],
)
def test_warm_up_takes_as_many_processes_as_it_may(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], jobs: str, rows: list[tuple[str, ...]]
) -> None:
    driven: list[tuple[str, ...]] = []
    monkeypatch.setattr(warm_up, "compile_ahead", lambda drives, report: driven.append(drives) or ())
    assert cli.main(["warmup", "--jobs", jobs]) == 0
    assert driven == rows
    assert "functions compiled" in capsys.readouterr().out


def test_a_run_that_fails_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert set(warm_up.FIRST + warm_up.LATER) == set(warmup.LINES)
    monkeypatch.setattr(warm_up, "compile_ahead", lambda drives, report: ("log",) if "log" in drives else ())
    assert cli.main(["warmup"]) == 1
    said = capsys.readouterr()
    assert "mecp_env.cli.warmup log" in said.out + said.err
    assert "functions compiled" not in said.out
    (tmp_path / "file").touch()
    monkeypatch.setattr(jit, "cache_directory", lambda: tmp_path / "file" / "cache")
    assert cli.main(["warmup"]) == 1  # where nothing can be kept
