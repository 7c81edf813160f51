"""Compiling ahead: the list of functions, types as plain data, processes only where they are wanted."""

from __future__ import annotations

import json
import multiprocessing
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from numba import typeof, types

from mecp_env.core import warm_up, warm_up_list
from mecp_env.core.jit import compiled
from mecp_env.slam.config import SlamConfig

FROZEN = np.zeros(3)
FROZEN.setflags(write=False)
NUMBERS = (True, 1.5, 3)


@compiled
def twice(x: float) -> float:
    return 2.0 * x


@pytest.mark.parametrize(
    "value",
    [*NUMBERS, np.zeros((2, 3)), np.zeros(4, np.int16), np.zeros((2, 2), bool), FROZEN, (1, 2.0), (1.0, 2.0)],
)
def test_types_survive_as_plain_data(value: object) -> None:
    kind = typeof(value)
    assert warm_up_list.decode(json.loads(json.dumps(warm_up_list.encode(kind)))) == kind


@pytest.mark.parametrize("section", [section for _, section in SlamConfig() if hasattr(section, "record")])
def test_records_of_settings_survive_too(section: object) -> None:
    kind = typeof(section.record)  # type: ignore[attr-defined]
    assert warm_up_list.decode(json.loads(json.dumps(warm_up_list.encode(kind)))) == kind


def test_other_kinds_are_refused() -> None:
    with pytest.raises(ValueError, match="no function takes"):
        warm_up_list.encode(typeof("text"))


def test_the_list_is_up_to_date() -> None:
    stale = []
    for entry in warm_up_list.entries():
        try:
            assert hasattr(warm_up_list.function_of(entry), "py_func")
            [warm_up_list.decode(argument) for argument in entry[2]]
        except (ImportError, AttributeError):
            stale.append(f"{entry[0]}.{entry[1]}")
    assert len(warm_up_list.entries()) > 50
    assert not stale, "record the list again: python -m mecp_env.cli.record_signatures"


def test_entries_that_fit_no_function_are_skipped() -> None:
    entries = [["no.such.module", "f", []], [__name__, "twice", ["float64"]], [__name__, "gone", []]]
    seen: list[tuple[int, int]] = []
    warm_up.compile_all(entries, 1, lambda done, total: seen.append((done, total)))
    assert (types.float64,) in twice.signatures  # type: ignore[attr-defined]
    assert seen == [(done, 3) for done in range(4)]


def test_one_process_per_core_or_as_the_environment_variable_sets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1, 2}, raising=False)
    monkeypatch.delenv(warm_up.SWITCH, raising=False)
    assert warm_up.processes_allowed() == 3
    for word, count in {"2": 2, "8": 3, "0": 0, "none": 0}.items():
        monkeypatch.setenv(warm_up.SWITCH, word)
        assert warm_up.processes_allowed() == count


def _prepared() -> int:
    """How many times a worker of a pool compiled ahead."""
    calls: list[None] = []
    warm_up._prepare_once = lambda: calls.append(None)  # type: ignore[assignment]
    os.environ.pop(warm_up.SWITCH, None)
    warm_up.prepare()
    return len(calls)


def test_a_worker_of_a_pool_never_compiles_ahead() -> None:
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply(_prepared) == 0


def test_only_one_process_at_a_time_compiles_ahead(tmp_path: Path) -> None:
    lock = tmp_path / "warm_up.lock"
    with warm_up._lock(lock) as free, warm_up._lock(lock) as second:
        assert free
        assert not second
    assert not lock.exists()
    lock.touch()
    long_ago = time.time() - 2 * warm_up.STALE_S
    os.utime(lock, (long_ago, long_ago))
    with warm_up._lock(lock) as free:
        assert free
    with warm_up._lock(tmp_path / "no folder" / "warm_up.lock") as free:
        assert not free


FIRST_USE = """
import numpy as np
from mecp_env.core import warm_up, warm_up_list
short = [["mecp_env.core.se2", "wrap_angle", ["float64"]], ["mecp_env.core.linalg", "solve_lower", {types}]]
warm_up_list.entries = lambda: short
warm_up.FEW = 1
warm_up.{change}
warm_up.prepare()
print(len(short), len(warm_up.missing_entries()))
"""


def first_use(folder: Path, change: str = "FEW = 1", **environment: str) -> tuple[list[int], str]:
    """Functions in a short list, those that the cache still lacks after the first use, and what was written."""
    types = [["array", "float64", 2, "C", True, True], ["array", "float64", 1, "C", True, True]]
    variables = {name: value for name, value in os.environ.items() if name != warm_up.SWITCH}
    code = FIRST_USE.format(types=types, change=change)
    variables |= {"NUMBA_CACHE_DIR": str(folder), "PYTHONPATH": str(Path(warm_up.__file__).parents[2])} | environment
    done = subprocess.run([sys.executable, "-c", code], env=variables, capture_output=True, text=True, check=True)
    return [int(word) for word in done.stdout.split()], done.stderr


@pytest.mark.slow
def test_first_use_announces_compiles_and_leaves_nothing_behind(tmp_path: Path) -> None:
    (wanted, left), written = first_use(tmp_path)
    assert wanted == 2
    assert left == 0
    assert written.count("\n") == 1
    assert "compiling" in written
    assert warm_up.SWITCH in written
    assert not list(tmp_path.rglob("*.lock"))
    assert first_use(tmp_path) == ([wanted, 0], "")


def test_first_use_can_be_switched_off(tmp_path: Path) -> None:
    (wanted, left), written = first_use(tmp_path, **{warm_up.SWITCH: "0"})
    assert (left, written) == (wanted, "")


def test_a_helper_that_dies_is_survived(tmp_path: Path) -> None:
    (wanted, left), _ = first_use(tmp_path, change="sys.executable = '/bin/false'")
    assert left == wanted


LOAD = """
from mecp_env.core import jit, warm_up, warm_up_list
warm_up_list.entries = lambda: [["mecp_env.core.se2", "wrap_angle", ["float64"]]]
warm_up.FEW = {few}
warm_up.load()
print(jit.variants())
"""


def loaded(folder: Path, few: int) -> int:
    """Functions of a list of one that a new process has loaded, where `few` missing ones are left uncompiled."""
    variables = os.environ | {"NUMBA_CACHE_DIR": str(folder), "PYTHONPATH": str(Path(warm_up.__file__).parents[2])}
    command = [sys.executable, "-c", LOAD.format(few=few)]
    return int(subprocess.run(command, env=variables, capture_output=True, text=True, check=True).stdout)


@pytest.mark.slow
def test_what_the_cache_has_is_loaded_and_a_few_missing_functions_are_compiled(tmp_path: Path) -> None:
    assert loaded(tmp_path, few=1) == 0
    assert loaded(tmp_path, few=2) == 1  # compiled
    assert loaded(tmp_path, few=1) == 1  # from the cache
