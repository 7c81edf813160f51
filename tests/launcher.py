"""Processes that start at once: forks of one that has imported what is slow to import, and nothing else of ours.

Each is a process of its own, with its own memory, environment variables and exit code, as one that a shell starts.
"""

import contextlib
import importlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, Self

LONGEST = 1 << 17  # bytes of a message
GIVE_UP_S = 300.0


class Process:
    """A process that a `Launcher` started, with those methods of `subprocess.Popen` that tests use."""

    def __init__(self, answers: socket.socket, stdout: IO[str]) -> None:
        self.stdout, self.returncode, self._answers = stdout, None, answers
        self.pid: int = self._answer(GIVE_UP_S)

    def _answer(self, timeout: float | None) -> int:
        self._answers.settimeout(timeout)
        return int(self._answers.recv(LONGEST))

    def wait(self, timeout: float | None = None) -> int:
        """The exit code; minus the number of the signal that ended it."""
        if self.returncode is None:
            self.returncode = self._answer(timeout)
        return self.returncode

    def poll(self) -> int | None:
        """The exit code, or None while it runs."""
        with contextlib.suppress(BlockingIOError):
            self.wait(0.0)
        return self.returncode

    def send_signal(self, number: int) -> None:
        os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def communicate(self, timeout: float = GIVE_UP_S) -> tuple[str, None]:
        """The rest of what it wrote, at its end."""
        with self.stdout:
            said = self.stdout.read()  # until nobody can write any more
        self.wait(timeout)
        return said, None


class Launcher:
    """Starts processes that have imported some modules already."""

    def __init__(self, *modules: str, path: Path | None = None) -> None:
        self._control, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with far:
            self._server = subprocess.Popen(
                # without bytecode, which would hide a change of a file within a second
                [sys.executable, "-B", "-P", __file__, str(far.fileno()), *modules],
                pass_fds=[far.fileno()],
                env=os.environ | ({"PYTHONPATH": str(path)} if path else {}),
                stdin=subprocess.DEVNULL,
                cwd=path,
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._control.close()
        self._server.wait(GIVE_UP_S)

    def start(self, code: str, *words: str, cwd: Path, env: dict[str, str]) -> Process:
        """`python -c CODE WORDS` in a folder; its errors are among its output."""
        reading, writing = os.pipe()
        near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        job = {"code": code, "words": words, "cwd": str(cwd), "env": env}
        with far:
            socket.send_fds(self._control, [json.dumps(job).encode()], [far.fileno(), writing])
        os.close(writing)
        return Process(near, os.fdopen(reading))


def jobs(control: socket.socket) -> Iterator[dict[str, Any]]:
    """In the forks of this process: the job of each; here it waits for the next one, until nobody can ask any more."""
    while True:
        message, files, _, _ = socket.recv_fds(control, LONGEST, 2)
        if not message:
            return
        answers, output = files
        pid = os.fork()
        if pid == 0:
            control.close()
            os.close(answers)
            os.dup2(output, 1)
            os.dup2(output, 2)
        os.close(output)
        if pid == 0:
            yield json.loads(message)
        threading.Thread(target=tell, args=(answers, pid)).start()


def tell(answers: int, pid: int) -> None:
    """Tell who asked for a job its id and its exit code."""
    with socket.socket(fileno=answers) as asked:
        asked.send(str(pid).encode())
        asked.send(str(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])).encode())


def become(job: dict[str, Any]) -> None:
    """Take the environment of a job, as far as Python and numba read it at their start."""
    os.environ.clear()
    os.environ.update(job["env"])
    os.chdir(job["cwd"])
    sys.argv = ["-c", *job["words"]]
    sys.path[:0] = [job["cwd"], *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
    if "numba" in sys.modules:
        sys.modules["numba"].config.reload_config()


def warm_up_numba() -> None:
    """Let numba make what it makes at its first compilation."""
    import numba

    numba.njit(lambda x: 2.0 * x)(1.0)


if __name__ == "__main__":
    for name in sys.argv[2:]:
        importlib.import_module(name)
    if "numba" in sys.modules:
        warm_up_numba()
    for job in jobs(socket.socket(fileno=int(sys.argv[1]))):
        become(job)
        exec(compile(job["code"], "<string>", "exec"), {"__name__": "__main__"})  # noqa: S102  (as `python -c` does)
        break
