"""Source trees to compare: the working tree, and a copy of a git commit in a temporary folder."""

from __future__ import annotations

import compileall
import contextlib
import io
import json
import os
import signal
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from benchmarks.common import OptionError

WORKING_TREE = Path(__file__).resolve().parent.parent
PATIENCE_S = 5.0  # a worker that has not ended by then is killed


class TreeError(RuntimeError):
    """A tree could not be run."""


@contextlib.contextmanager
def checkout(ref: str) -> Iterator[Path]:
    """A copy of a commit's files, removed at the end, also after Ctrl-C. Raises `OptionError` for no commit."""
    commit = _git("rev-parse", "--verify", "--quiet", "--end-of-options", f"{ref}^{{commit}}")
    if commit.returncode:
        raise OptionError(f"--against {ref}: no such commit in {WORKING_TREE.name}")
    archive = _git("archive", "--format=tar", commit.stdout.decode().strip())
    if archive.returncode:
        raise OptionError(f"--against {ref}: {archive.stderr.decode(errors='replace').strip()}")
    with tempfile.TemporaryDirectory(prefix="mecp_env-tree-") as folder:
        with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as files:
            files.extractall(folder, filter="data")
        compileall.compile_dir(Path(folder, "mecp_env"), quiet=2)  # as in a tree that has been used
        yield Path(folder).resolve()


def _git(*words: str) -> subprocess.CompletedProcess[bytes]:
    try:
        return subprocess.run(["git", "-C", str(WORKING_TREE), *words], capture_output=True, check=False)
    except FileNotFoundError:
        raise OptionError("--against: git is not installed") from None


def command(*arguments: str) -> list[str]:
    """The command that runs `in_tree.py`; `-P`: the folder of the script is not put on the path."""
    return [sys.executable, "-P", str(Path(__file__).with_name("in_tree.py")), *arguments]


def environment_of(tree: Path, **variables: str) -> dict[str, str]:
    """The environment variables of a process in a tree: it and its children import the package of that tree."""
    return os.environ | {"PYTHONPATH": str(tree)} | variables


def end_group(process: subprocess.Popen[str]) -> None:
    """End a process that leads a group, and all that it started."""
    with contextlib.suppress(OSError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


class TreeWorker:
    """A process that runs `in_tree.py` in one tree and answers calls; it waits idle between them.

    It leads a process group, which ends with it.
    """

    def __init__(self, name: str, tree: Path, *arguments: str) -> None:
        self.name = name
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  (it lives as long as the worker)
        self._process = subprocess.Popen(
            command("drive", *arguments),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env=environment_of(tree),
            cwd=tree,
            text=True,
            start_new_session=True,
        )
        self._tree = tree

    def __enter__(self) -> TreeWorker:
        return self

    def __exit__(self, *_: object) -> None:
        """End the process and all that it started."""
        with contextlib.suppress(OSError):
            self._pipe(self._process.stdin).close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(PATIENCE_S)
        end_group(self._process)
        self._pipe(self._process.stdout).close()
        self._errors.close()

    def check_package(self) -> None:
        """Raise `TreeError` unless the worker imported the package of its tree."""
        found = Path(self._answer()["package"]).resolve()
        if self._tree not in found.parents:
            raise TreeError(f"{self.name}: it imported {found}, not the package in {self._tree}")

    def call(self, method: str, *arguments: Any) -> dict[str, Any]:
        """What a method of `in_tree.Driver` returns. Raises `TreeError` with what a dead worker wrote last."""
        with contextlib.suppress(BrokenPipeError):
            pipe = self._pipe(self._process.stdin)
            pipe.write(json.dumps([method, *arguments]) + "\n")
            pipe.flush()
        return self._answer()

    def _answer(self) -> dict[str, Any]:
        line = self._pipe(self._process.stdout).readline()
        if not line:
            code = self._process.wait()
            self._errors.seek(0)
            last = self._errors.read().decode(errors="replace").strip()
            raise TreeError(f"{self.name}: the worker ended with exit code {code}\n{last}")
        answer: dict[str, Any] = json.loads(line)
        return answer

    @staticmethod
    def _pipe(pipe: IO[str] | None) -> IO[str]:
        assert pipe is not None
        return pipe
