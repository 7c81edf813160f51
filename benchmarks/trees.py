"""Source trees to compare: the working tree, and a copy of a git commit in a temporary folder."""

from __future__ import annotations

import compileall
import contextlib
import io
import json
import os
import resource
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.common import OptionError, Options, in_turns
from mecp_env.core.errors import MecpError

WORKING_TREE = Path(__file__).resolve().parent.parent
SCRIPT = Path(__file__).with_name("in_tree.py")
HERE = "working tree"


class TreeError(MecpError):
    """A tree could not be run."""


def in_turns_by_tree(options: Options, runs: int, measure: Callable[[Path], Any]) -> dict[str, list[Any]]:
    """What is measured in the working tree, and in turns with it in that of `--against`, by the name of the tree."""
    trees = {HERE: WORKING_TREE}
    with contextlib.ExitStack() as stack:
        if options.against is not None:
            trees[options.against] = stack.enter_context(checkout(options.against))
        turns = in_turns({name: partial(measure, tree) for name, tree in trees.items()}, runs)
    return {name: [turn[name] for turn in turns] for name in trees}


@contextlib.contextmanager
def checkout(ref: str) -> Iterator[Path]:
    """A copy of a commit's files, removed at the end, also after Ctrl-C. Raises `OptionError` for no commit."""
    commit = _git("rev-parse", "--verify", "--quiet", "--end-of-options", f"{ref}^{{commit}}")
    if commit.returncode:
        raise OptionError(f"--against {ref}: no such commit in {WORKING_TREE.name}")
    archive = _git("archive", "--format=tar", commit.stdout.decode().strip())
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


def run_in(tree: Path, *arguments: str, **variables: str) -> dict[str, Any]:
    """What `in_tree.py` answers in a tree, with `cpu_s` and `wall_s` of it and the processes that it waited for.

    Raises `TreeError` with what a process that failed wrote.
    """
    words = [sys.executable, "-P", str(SCRIPT), *arguments]  # -P: the folder of the script is not put on the path
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    ended = subprocess.run(
        words,
        cwd=tree,
        env=os.environ | {"PYTHONPATH": str(tree)} | variables,
        capture_output=True,
        text=True,
        check=False,
    )
    used, wall_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - begun
    if ended.returncode:
        raise TreeError(f"{tree}: {SCRIPT.name} ended with exit code {ended.returncode}\n{ended.stderr.strip()}")
    answer: dict[str, Any] = json.loads(ended.stdout.splitlines()[-1])
    return answer | {"cpu_s": used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime, "wall_s": wall_s}
