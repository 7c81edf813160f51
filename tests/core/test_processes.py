"""Worker processes (tests/vector has more), and how many cores a process may use."""

import os
import signal
import time
from pathlib import Path
from typing import Any

import pytest

from mecp_env.core import processes
from mecp_env.core.processes import THREADS, Failure, Worker, WorkerDied, WorkerPool, cores
from tests.processes import gone_within, needs_linux

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


@pytest.mark.parametrize(
    ("number", "words"), [(0, "ended with exit code 3"), (signal.SIGKILL, "was killed by SIGKILL")]
)
def test_what_ended_a_worker_is_said_in_words(worker: Worker, number: int, words: str) -> None:
    with pytest.raises(WorkerDied, match=f"^worker 7 {words}$"):
        ask(worker, "end", number)


def test_an_exception_comes_with_place_and_traceback(worker: Worker) -> None:
    failure = ask(worker, "fail", KeyError("x"))
    assert isinstance(failure, Failure)
    assert isinstance(failure.error, KeyError)
    assert failure.note.startswith("in room 3:\nTraceback")
    assert failure.reason.startswith("KeyError: 'x' (fail, line ")
    assert isinstance(ask(worker, "open"), str)  # and it goes on


def test_a_pool_that_loses_a_worker_stops_the_others_and_says_so() -> None:
    pool = WorkerPool({"a": Target("a"), "b": Target("b")}, "fork")
    pids = pool.pids
    pool.ask("open", [(), ()])
    assert pool.gather() == ["a", "b"]
    os.kill(pids[1], signal.SIGKILL)
    assert gone_within(pids[1:], 1.0)
    with pytest.raises(WorkerDied, match="b was killed by SIGKILL; the others are stopped"):
        pool.ask("open", [(), ()])
    assert gone_within(pids, 1.0)
    pool.close()


def test_a_worker_that_does_not_stop_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "STOP_S", 0.3)
    pool = WorkerPool({"slow": Target("slow")}, "fork")
    pids, start = pool.pids, time.monotonic()
    pool.close()
    assert time.monotonic() - start < 3.0
    assert gone_within(pids, 0.0)


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
        (limited("/a", a="max"), 4),
        (limited("/a", a="150000"), 2),
        (limited("/a/b", a="300000", b="max"), 3),  # the limit of a group around it
        (limited("/docker/1f", root="200000"), 2),  # in a container: its group is mounted as the root
    ],
)
def test_the_smallest_limit_counts(
    tmp_path: Path, files: dict[str, str], expected: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2, 3}, raising=False)
    assert cores(write(tmp_path, files)) == expected
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {5}, raising=False)
    assert cores(tmp_path) == 1
