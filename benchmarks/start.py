"""The first start: CPU seconds and cache files when no function has been compiled yet.

A process with an empty cache makes `two_rooms`, resets it, takes 30 steps and drives to one goal. The CPU time is that
of the process and of every process that it starts. With `--against GIT_REF`, both trees take turns.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from benchmarks.common import Figures, Options
from benchmarks.tables import summary
from benchmarks.trees import HERE, in_turns_by_tree, run_in

RUNS, QUICK_RUNS = 3, 1


def run(options: Options) -> Figures:
    """Figures of the working tree; with `options.against` those of the other tree beside them."""
    found = in_turns_by_tree(options, QUICK_RUNS if options.quick else RUNS, first_start)
    figures = {
        name: summary(runs, ("cpu_s", "wall_s")) | {"cache_files": max(run["cache_files"] for run in runs)}
        for name, runs in found.items()
    }
    other = {"commit": options.against, **figures[options.against]} if options.against else None
    return figures[HERE] | ({"against": other} if other else {})


def first_start(tree: Path) -> Figures:
    """CPU and wall seconds of one first start, and how many files its cache has then."""
    with tempfile.TemporaryDirectory(prefix="mecp_env-cache-") as cache:
        used = run_in(tree, "start", NUMBA_CACHE_DIR=cache)
        return used | {"cache_files": sum(path.is_file() for path in Path(cache).rglob("*"))}
