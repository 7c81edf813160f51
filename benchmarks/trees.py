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
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from benchmarks.common import OptionError

WORKING_TREE = Path(__file__).resolve().parent.parent


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


@contextlib.contextmanager
def started(tree: Path, words: Sequence[str], variables: Mapping[str, str], **streams: Any) -> Iterator[Any]:
    """A process in a tree, whose children import the package of that tree; at the end it and all of them are ended."""
    process = subprocess.Popen(
        words,
        cwd=tree,
        env=os.environ | {"PYTHONPATH": str(tree), **variables},
        text=True,
        start_new_session=True,
        **streams,
    )
    try:
        yield process
    finally:
        with contextlib.suppress(OSError):
            os.killpg(process.pid, signal.SIGKILL)
        with contextlib.suppress(BrokenPipeError), process:  # it may end before it has read everything
            pass


@contextlib.contextmanager
def tree_worker(name: str, tree: Path, *arguments: str) -> Iterator[TreeWorker]:
    """A process that runs `in_tree.py` in one tree and answers calls; it waits idle between them."""
    pipe = subprocess.PIPE
    with (
        tempfile.TemporaryFile() as errors,
        started(tree, command("drive", *arguments), {}, stdin=pipe, stdout=pipe, stderr=errors) as process,
    ):
        yield TreeWorker(name, process, errors)


@dataclass(frozen=True, slots=True)
class TreeWorker:
    """The calls of a worker."""

    name: str
    process: Any
    errors: IO[bytes]

    def call(self, method: str, *arguments: Any) -> dict[str, Any]:
        """What a method of `in_tree.BlockDriver` returns. Raises `TreeError` with what a dead worker wrote last."""
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.write(json.dumps([method, *arguments]) + "\n")
            self.process.stdin.flush()
        line = self.process.stdout.readline()
        if not line:
            code = self.process.wait()
            self.errors.seek(0)
            last = self.errors.read().decode(errors="replace").strip()
            raise TreeError(f"{self.name}: the worker ended with exit code {code}\n{last}")
        return json.loads(line)
