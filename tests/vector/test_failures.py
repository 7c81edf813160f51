"""A batch whose worker is killed, whose environment raises, or that is not closed."""

import multiprocessing
import os
import re
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
from tests.vector.helpers import N, make_small

ROOT = Path(__file__).parents[2]
STILL = np.zeros((N, 2), np.float32)
SOON_S = 5.0
pytestmark = needs_linux


class Slow(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Takes long over a step, in a worker."""

    def step(self, action: Any) -> Any:
        time.sleep(60.0 if multiprocessing.parent_process() else 0.0)
        return super().step(action)


def run_script(text: str, **keywords: Any) -> subprocess.Popen[str]:
    """A Python process that runs `text`."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, "-c", text], env=environment, **pipes, **keywords)


START = """
import os, signal, sys, time, numpy as np, mecp_env
signal.signal(signal.SIGINT, signal.default_int_handler)  # tests that run in the background are deaf to it
from tests.vector.helpers import make_small
a, b = make_small(), make_small()
a.reset(seed=1)
print(*a.pids, *b.pids, flush=True)
"""


def test_a_worker_killed_between_two_steps_is_named_and_nothing_is_left() -> None:
    venv = make_small()
    venv.reset(seed=1)
    pids = venv.pids
    os.kill(pids[1], signal.SIGKILL)
    start = time.monotonic()
    with pytest.raises(WorkerDied, match=r"worker 1 \(environments 1 to 2\) was killed by SIGKILL"):
        venv.step(STILL)
    assert time.monotonic() - start < SOON_S
    assert gone_within(pids, SOON_S)
    venv.close()
    venv.close()
    with pytest.raises(ClosedEnvironmentError):
        venv.reset()


@pytest.mark.parametrize(("killed", "wait"), [(0, "step_wait"), (1, "step_wait"), (1, "recv")])
def test_a_worker_killed_at_work_is_named_though_others_are_busy(killed: int, wait: str) -> None:
    venv = make_small(wrappers=(Slow,))
    venv.reset(seed=1)
    pids = venv.pids
    (venv.step_async if wait == "step_wait" else venv.send)(STILL)
    threading.Timer(0.3, os.kill, (pids[killed], signal.SIGKILL)).start()
    start = time.monotonic()
    with pytest.raises(WorkerDied, match=f"worker {killed} "):
        getattr(venv, wait)()
    assert venv.closed
    assert time.monotonic() - start < SOON_S
    assert gone_within(pids, SOON_S)


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
    for process in multiprocessing.active_children():
        if process.pid in pids:
            process.terminate()
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
        venv = make_small(**keywords)
        venv.reset(seed=1)
        pids = venv.pids
        venv.step_async(STILL)
        start = time.monotonic()
        venv.close()
        assert time.monotonic() - start < 3.5
        assert gone_within(pids, 0.0)


def test_a_batch_that_nobody_holds_closes_itself() -> None:
    venv = make_small()
    pids = venv.pids
    del venv
    assert gone_within(pids, SOON_S)


@pytest.mark.slow
def test_leaving_without_closing_is_clean() -> None:
    done = run_script(START)
    out, err = done.communicate(timeout=60)
    assert (done.returncode, err) == (0, "")
    assert gone_within([int(pid) for pid in out.split()], SOON_S)


@pytest.mark.parametrize("context", ["fork", pytest.param("forkserver", marks=pytest.mark.slow)])
def test_workers_end_when_the_process_that_they_work_for_is_killed(context: str) -> None:
    made = f"a, b = make_small(context={context!r}), make_small(context={context!r})"
    script = START.replace("a, b = make_small(), make_small()", made)
    process = run_script(script + "a.step_async(np.zeros((3, 2), np.float32)); time.sleep(60)")
    assert process.stdout is not None
    pids = [int(pid) for pid in process.stdout.readline().split()]
    assert len(pids) == 4
    process.kill()
    process.wait()
    assert gone_within(pids, SOON_S)


@pytest.mark.slow
def test_interrupting_is_one_traceback_and_leaves_nothing() -> None:
    process = run_script(START + "time.sleep(60)", start_new_session=True)
    assert process.stdout is not None
    pids = [int(pid) for pid in process.stdout.readline().split()]
    os.killpg(process.pid, signal.SIGINT)  # as Ctrl-C does: to all of them
    _, err = process.communicate(timeout=60)
    assert err.count("Traceback") == 1
    assert err.rstrip().endswith("KeyboardInterrupt")
    assert gone_within(pids, SOON_S)


def test_after_an_interrupted_wait_the_step_can_still_be_had() -> None:
    venv = make_small()
    venv.reset(seed=1)
    venv.step_async(STILL)
    real, calls = venv._pool._answer, []

    def interrupted(worker: int) -> Any:
        calls.append(worker)
        if calls == [0, 1]:
            raise KeyboardInterrupt
        return real(worker)

    venv._pool._answer = interrupted
    with pytest.raises(KeyboardInterrupt):
        venv.step_wait()
    assert venv.step_wait()[4]["period"].tolist() == [1] * N
    assert calls == [0, 1, 1]


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
    venv = make_small(1, workers=None)
    venv.reset(seed=1)
    pipe.send(venv.step(STILL[:1])[-1]["period"].tolist())


GROWTH_MB = 5.0
STEPS = 20  # of an episode


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
