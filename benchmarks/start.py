"""The first start: CPU seconds and cache files when no function has been compiled yet.

A process with an empty cache makes `two_rooms`, resets it, takes 30 steps and drives to one goal. The CPU time is that
of the process and of every process that it starts. With `--against GIT_REF`, both trees take turns.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.common import Figures, Gate, Options, estimate
from benchmarks.tables import table_of
from benchmarks.trees import WORKING_TREE, TreeError, checkout, command, started

RUNS = 3
QUICK_RUNS = 1

GATES = (Gate("cpu_s", "time", 1.2), Gate("cache_files", "error", 1.1))


def run(options: Options) -> Figures:
    """Figures of the working tree; with `options.against` those of the other tree beside them."""
    runs = QUICK_RUNS if options.quick else RUNS
    if options.against is None:
        return summarise([first_start("working tree", WORKING_TREE) for _ in range(runs)])
    with checkout(options.against) as other:
        pairs = [(first_start("working tree", WORKING_TREE), first_start(options.against, other)) for _ in range(runs)]
    here, there = zip(*pairs, strict=True)
    return summarise(list(here)) | {"against": {"commit": options.against, **summarise(list(there))}}


def first_start(name: str, tree: Path) -> Figures:
    """CPU and wall seconds of one first start, and how many files its cache has then. Raises `TreeError`."""
    words = [sys.executable, str(Path(__file__).with_name("cpu_cost.py")), *command("start")]
    pipe = subprocess.PIPE
    with (
        tempfile.TemporaryDirectory(prefix="mecp_env-cache-") as cache,
        started(tree, words, {"NUMBA_CACHE_DIR": cache}, stdout=pipe, stderr=pipe) as process,
    ):
        answer, errors = process.communicate()
        figures: Figures = json.loads(answer or '{"code": -1}')
        if figures.pop("code"):
            raise TreeError(f"{name}: the first start failed\n{errors.strip()}")
        return figures | {"cache_files": sum(path.is_file() for path in Path(cache).rglob("*"))}


def summarise(runs: list[Figures]) -> Figures:
    """Mean times with intervals; the number of files is the same in every run, or else the largest counts."""
    times: Figures = {name: estimate([run[name] for run in runs]) for name in ("cpu_s", "wall_s")}
    return times | {"cache_files": max(run["cache_files"] for run in runs)}


def report(figures: Figures) -> str:
    """One row for each tree."""
    trees = {"working tree": figures}
    if "against" in figures:
        trees[figures["against"]["commit"]] = figures["against"]
    return table_of("tree", ("cpu_s", "wall_s", "cache_files"), trees)
