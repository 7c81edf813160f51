"""Memory and open files do not grow, over many steps, episodes and batches."""

from __future__ import annotations

import multiprocessing
import os
import re
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from mecp_env.vector import BatchEnv
from tests.processes import needs_linux
from tests.vector.helpers import make_small

GROWTH_MB = 5.0
STEPS = 20  # of an episode
pytestmark = needs_linux


def footprint(venv: BatchEnv) -> tuple[float, int]:
    """Memory (MB) and open files of a batch: its workers and this process.

    Pages of files do not count: a library may be loaded late, and a forked process makes pages that it inherited
    its own when it first writes there.
    """
    pids = [os.getpid(), *venv.pids]
    pages = [Path(f"/proc/{pid}/smaps_rollup").read_text() for pid in pids]
    kilobytes = sum(int(re.findall(r"\nAnonymous:\s+(\d+)", page)[0]) for page in pages)
    return kilobytes / 1e3, sum(len(list(Path(f"/proc/{pid}/fd").iterdir())) for pid in pids)


def drive(venv: BatchEnv, steps: int) -> None:
    rng = np.random.default_rng(0)
    for _ in range(steps):
        venv.step(rng.uniform(-1.0, 1.0, (venv.num_envs, 2)).astype(np.float32))


@pytest.mark.slow
def test_steps_and_episodes_cost_no_memory_and_no_files() -> None:
    venv = make_small(4, max_steps=STEPS, autoreset_mode="SameStep")
    venv.reset(seed=0)
    drive(venv, 300)
    memory, files = footprint(venv)
    drive(venv, 900)
    grown, left = footprint(venv)
    venv.close()
    assert grown - memory < GROWTH_MB
    assert left == files


def loaded(env: gymnasium.Env[Any, Any]) -> int:
    """Compiled functions in the process of the environment, each for one set of types."""
    modules = [vars(module) for name, module in list(sys.modules.items()) if name.startswith("mecp_env.")]
    found = {id(value): value for module in modules for value in module.values() if hasattr(value, "py_func")}
    return sum(len(function.signatures) for function in found.values())


@pytest.mark.parametrize("context", ["fork", pytest.param("forkserver", marks=pytest.mark.slow)])
def test_workers_have_all_functions_from_the_start(context: str) -> None:
    """Each worker would otherwise load its own copy, late ones after many episodes."""
    venv = make_small(2, context=context)
    before = venv.each(loaded, [(), ()])
    venv.reset(seed=0)
    drive(venv, 100)
    after = venv.each(loaded, [(), ()])
    venv.close()
    assert min(before) > 50
    assert after == before


def test_batches_leave_no_files_and_no_processes_behind() -> None:
    def once() -> int:
        venv = make_small()
        venv.reset(seed=0)
        venv.close()
        return len(list(Path("/proc/self/fd").iterdir()))

    once()
    before = once()
    assert [once() for _ in range(5)] == [before] * 5
    assert not [child for child in multiprocessing.active_children() if child.name.startswith("mecp_env")]
