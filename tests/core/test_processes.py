"""Single worker processes (tests/vector has those of a pool), and how many cores a process may use."""

import os
import signal
from pathlib import Path
from typing import Any

import pytest

from mecp_env.core.processes import THREADS, Worker, WorkerDied, cores
from tests.processes import needs_linux

pytestmark = needs_linux


class Target:
    """Answers questions of a test."""

    def signals(self) -> tuple[bool, bool]:
        """Whether Ctrl-C is blocked, and ignored."""
        blocked = signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])
        return blocked, signal.getsignal(signal.SIGINT) == signal.SIG_IGN

    def threads(self) -> set[str | None]:
        return {os.environ.get(name) for name in THREADS}

    def end(self, number: int) -> None:
        os.kill(os.getpid(), number) if number else os._exit(3)


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
def test_what_ended_a_worker_is_said_in_words(number: int, words: str) -> None:
    worker = Worker(Target(), "worker 7", "fork")
    with pytest.raises(WorkerDied, match=f"^worker 7 {words}$"):
        ask(worker, "end", number)
    worker.stop()


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
