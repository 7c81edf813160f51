"""Worker processes (tests/vector has more), how much memory a process keeps, and how many cores it may use."""

import ctypes
import os
import platform
import signal
import time
import traceback
from pathlib import Path
from typing import Any

import pytest

from benchmarks.process_use import memory_mb
from mecp_env.core import processes
from mecp_env.core.processes import THREADS, Failure, Worker, WorkerDied, WorkerPool, cores
from tests.processes import gone_within, needs_linux, run_python

pytestmark = needs_linux


class Target:
    """Answers questions of a test."""

    place = "room 3"

    def __init__(self, name: str = "") -> None:
        self.name = name

    def open(self) -> str:
        return self.name

    def close(self) -> None:
        if self.name == "slow":
            time.sleep(60)

    def signals(self) -> tuple[bool, bool]:
        """Whether Ctrl-C is blocked, and ignored."""
        blocked = signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])
        return blocked, signal.getsignal(signal.SIGINT) == signal.SIG_IGN

    def threads(self) -> set[str | None]:
        return {os.environ.get(name) for name in THREADS}

    def end(self, number: int) -> None:
        os.kill(os.getpid(), number) if number else os._exit(3)

    def fail(self, error: Exception) -> None:
        raise error


@pytest.fixture
def worker() -> Any:
    made = Worker(Target("x"), "worker 7", "fork")
    yield made
    made.stop()


def ask(worker: Worker, name: str, *arguments: Any) -> Any:
    worker.ask(name, *arguments)
    return worker.answer()


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_a_worker_has_one_thread_and_is_out_of_reach_of_ctrl_c(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS[0], "5")
    monkeypatch.delenv(THREADS[1], raising=False)
    worker = Worker(Target(), "worker 7", method)
    assert ask(worker, "signals") == (True, True)
    assert ask(worker, "threads") == {"1"}
    worker.stop()
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])  # here it is as before
    assert os.environ[THREADS[0]] == "5"
    assert THREADS[1] not in os.environ


ASK_A_FORK_SERVER = """
from tests.core.test_processes import Target, Worker, ask
worker = Worker(Target(), "worker 7", "forkserver")
print(*ask(worker, "signals"), ask(worker, "threads"))
worker.stop()
"""


def test_a_worker_of_a_fork_server_is_the_same() -> None:
    """In a process of its own: a server that another library started has that library's settings."""
    assert run_python(ASK_A_FORK_SERVER) == "True True {'1'}\n"


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (0, "worker 7 ended with exit code 3"),
        (signal.SIGKILL, "worker 7 was killed by SIGKILL"),
        (signal.SIGTERM, "worker 7 was killed by SIGTERM"),
    ],
)
def test_what_ended_a_worker_is_said_in_words(worker: Worker, number: int, words: str) -> None:
    with pytest.raises(WorkerDied, match=f"^{words}$"):
        ask(worker, "end", number)


def test_an_exception_comes_with_place_and_traceback(worker: Worker) -> None:
    failure = ask(worker, "fail", KeyError("x"))
    assert isinstance(failure, Failure)
    assert isinstance(failure.error, KeyError)
    assert failure.note.startswith("in room 3:\nTraceback")
    assert failure.reason.startswith("KeyError: 'x' (fail, line ")
    assert isinstance(ask(worker, "open"), str)  # and it goes on


def views_kept_by(error: BaseException | None) -> list[memoryview]:
    """Views of memory among the variables that an exception and its causes keep alive."""
    if error is None:
        return []
    kept = [value for frame, _ in traceback.walk_tb(error.__traceback__) for value in frame.f_locals.values()]
    return [value for value in kept if isinstance(value, memoryview)] + views_kept_by(error.__context__)


def test_a_pool_that_loses_a_worker_stops_the_others_and_says_so() -> None:
    pool = WorkerPool({"a": Target("a"), "b": Target("b")}, "fork")
    pids = pool.pids
    pool.ask("open", [(), ()])
    assert pool.gather() == ["a", "b"]
    os.kill(pids[1], signal.SIGKILL)
    assert gone_within(pids[1:], 1.0)
    with pytest.raises(WorkerDied, match="b was killed by SIGKILL; the others are stopped") as caught:
        pool.ask("open", [(), ()])
    assert views_kept_by(caught.value) == []
    assert gone_within(pids, 1.0)
    pool.close()


def test_a_worker_that_does_not_stop_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "STOP_S", 0.3)
    pool = WorkerPool({"slow": Target("slow")}, "fork")
    pids, start = pool.pids, time.monotonic()
    pool.close()
    assert time.monotonic() - start < 3.0
    assert gone_within(pids, 0.0)


GLIBC = pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library keeps memory in its own way")
AGAIN = """
import resource, numpy, mecp_env.core.processes
mecp_env.core.processes.keep()
def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    arrays = [numpy.ones(size << 17) for size in (9, 17, 31)]  # MB
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
print(faults(), faults())
"""


@GLIBC
def test_freed_memory_between_blocks_in_use_is_returned() -> None:
    blocks = [bytes(2_000) for _ in range(20_000)]
    kept = blocks[::1_000]
    del blocks
    before = memory_mb(["self"])
    processes.trim()
    assert memory_mb(["self"]) < before - 20.0
    assert len(kept) == 20


@GLIBC
def test_large_arrays_are_kept_for_later_where_that_is_asked_for() -> None:
    first, again = map(int, run_python(AGAIN).split())
    assert first > 10 * again


def test_another_c_library_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ctypes, "CDLL", lambda name: object())  # without these functions
    processes.trim()
    processes.keep()


FOUR = {0, 1, 2, 3}


def write(root: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


def limited(path: str, **limits: str) -> dict[str, str]:
    """The files of a process in a cgroup; the limit of each group by the last letter of its path."""
    groups = {"root": "", "a": "/a", "b": "/a/b"}
    files = {f"sys/fs/cgroup{groups[name]}/cpu.max": f"{quota} 100000\n" for name, quota in limits.items()}
    return files | {"proc/self/cgroup": f"0::{path}\n"}


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({}, 4),  # not Linux
        (limited("/"), 4),
        (limited("/a", a="max"), 4),
        (limited("/a", a="150000"), 2),
        (limited("/a", a="20000"), 1),
        (limited("/a", a="900000"), 4),
        (limited("/a/b", a="300000", b="max"), 3),  # the limit of a group around it
        (limited("/docker/1f", root="200000"), 2),  # in a container: its group is mounted as the root
    ],
)
def test_the_smallest_limit_counts(
    tmp_path: Path, files: dict[str, str], expected: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: FOUR, raising=False)
    assert cores(write(tmp_path, files)) == expected


def test_the_affinity_counts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {5}, raising=False)
    assert cores(write(tmp_path, limited("/a", a="300000"))) == 1
    assert cores() == 1
