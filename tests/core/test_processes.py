"""Worker processes: what they inherit, how they end, and what is said of one that dies (tests/vector has more)."""

import os
import signal
import time
import traceback
from typing import Any

import pytest

from mecp_env.core import processes
from mecp_env.core.processes import THREADS, Failure, Worker, WorkerDied, WorkerPool
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
