"""A batch whose worker is killed, whose environment raises, or that is not closed."""

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError

from mecp_env.core import processes
from mecp_env.vector import BatchEnv, WorkerDied
from tests.env.helpers import make
from tests.processes import gone_within, needs_linux
from tests.vector.helpers import N, make_small, started

ROOT = Path(__file__).parents[2]
STILL = np.zeros((N, 2), np.float32)
SOON_S = 5.0
pytestmark = needs_linux


class Slow(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Takes long over a step, in a worker."""

    def step(self, action: Any) -> Any:
        time.sleep(60.0 if multiprocessing.parent_process() else 0.0)
        return super().step(action)


SCRIPT = """
import signal, sys, time, mecp_env
signal.signal(signal.SIGINT, signal.default_int_handler)  # tests that run in the background are deaf to it
from tests.vector.helpers import make_small
a, b = make_small(context=sys.argv[1]), make_small(context=sys.argv[1])
print(*a.pids, *b.pids, flush=True)
input()
"""


@pytest.mark.parametrize(
    ("end", "context", "said"),
    [
        (None, "fork", ""),
        (signal.SIGKILL, "fork", ""),
        pytest.param(signal.SIGINT, "fork", "KeyboardInterrupt", marks=pytest.mark.slow),
        pytest.param(signal.SIGKILL, "forkserver", "", marks=pytest.mark.slow),
    ],
)
def test_no_worker_is_left_however_the_process_ends_that_it_works_for(end: Any, context: str, said: str) -> None:
    pipes: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    line, environment = [sys.executable, "-c", SCRIPT, context], os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(line, env=environment, text=True, start_new_session=True, **pipes)
    assert process.stdout is not None
    pids = [int(pid) for pid in process.stdout.readline().split()]
    assert len(pids) == 4
    if end == signal.SIGINT:
        os.killpg(process.pid, end)  # as Ctrl-C does: to all of them
    elif end is not None:
        process.kill()
    _, err = process.communicate("\n", timeout=60)
    assert err.count("Traceback") == bool(said)
    assert err.rstrip().endswith(said)
    assert gone_within(pids, SOON_S)


@pytest.mark.parametrize(("killed", "work"), [(0, "step"), (1, "send"), (1, "")])
def test_a_worker_killed_is_named_though_others_are_busy_and_nothing_is_left(killed: int, work: str) -> None:
    venv = started(wrappers=(Slow,) if work else ())
    pids = venv.pids
    ask, wait = (venv.send, venv.recv) if work == "send" else (venv.step_async, venv.step_wait)
    if work:
        ask(STILL)
    threading.Timer(0.3 * bool(work), os.kill, (pids[killed], signal.SIGKILL)).start()
    start = time.monotonic()
    said = rf"worker {killed} \(environments {killed} .*was killed by SIGKILL; the others are stopped"
    with pytest.raises(WorkerDied, match=said):
        wait() if work else venv.step(STILL)
    assert venv.closed
    assert time.monotonic() - start < SOON_S
    assert gone_within(pids, SOON_S)
    venv.close()
    with pytest.raises(ClosedEnvironmentError):
        venv.reset()


def test_workers_obey_though_the_process_that_they_work_for_does_not() -> None:
    """SDL catches SIGTERM where a window was opened; a forked worker inherits it."""
    before = signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        venv = make_small(wrappers=(Slow,))
    finally:
        signal.signal(signal.SIGTERM, before)
    venv.reset(seed=1)
    pids = venv.pids
    venv.step_async(STILL)
    for pid in pids:
        os.kill(pid, signal.SIGTERM)
    assert gone_within(pids, SOON_S)


def test_an_environment_that_cannot_be_made_in_a_worker_says_why() -> None:
    before = multiprocessing.active_children()
    owner = os.getpid()
    with pytest.raises(ValueError, match="only in the process") as caught:
        BatchEnv([make, partial(make_here, owner)], workers=2, context="fork")
    assert "in environment 1 of the batch" in caught.value.__notes__[0]
    with pytest.raises(ValueError, match="environment 1 has other spaces"):
        BatchEnv([make, partial(make, observation={"map": True})], workers=1, context="fork")
    assert multiprocessing.active_children() == before


def make_here(owner: int) -> Any:
    if os.getpid() != owner:
        raise ValueError("only in the process that it was made for")
    return make()


def test_closing_in_the_middle_of_a_step_is_quiet_and_does_not_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "STOP_S", 0.5)
    for keywords in ({"wrappers": (Slow,)}, {"max_steps": 1, "autoreset_mode": "SameStep"}):  # with a large answer
        venv = started(**keywords)
        pids = venv.pids
        venv.step_async(STILL)
        start = time.monotonic()
        venv.close()
        assert time.monotonic() - start < 3.5
        assert gone_within(pids, 0.0)


def test_a_worker_process_may_not_start_others_which_a_single_environment_does_not_need() -> None:
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe()
    process = context.Process(target=make_and_tell, args=(theirs,), daemon=True)
    process.start()
    assert 'vectorization_mode="sync"' in ours.recv()
    assert ours.recv() == [1]
    process.join()


def make_and_tell(pipe: Any) -> None:
    try:
        make_small()
    except RuntimeError as error:
        pipe.send(str(error))
    venv = started(1, workers=None)
    pipe.send(venv.step(STILL[:1])[-1]["period"].tolist())


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
    for action in np.random.default_rng(0).uniform(-1.0, 1.0, (100, 2, 2)).astype(np.float32):
        venv.step(action)
    after = venv.each(loaded, [(), ()])
    assert min(before) > 50
    assert after == before


def test_batches_leave_no_files_and_no_processes_behind_not_even_one_that_is_only_let_go() -> None:
    def once(closed: bool = True) -> int:
        venv = started()
        if closed:
            venv.close()
        del venv
        return len(list(Path("/proc/self/fd").iterdir()))

    once()
    before = once()
    assert [once(closed=k > 1) for k in range(4)] == [before] * 4
    assert not [child for child in multiprocessing.active_children() if child.name.startswith("mecp_env")]
