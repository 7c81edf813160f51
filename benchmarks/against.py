"""`speed --against GIT_REF`: step time of the working tree and of another commit, in alternating blocks on one core.

Two processes, one in each tree, drive the same episodes. They take turns in blocks of control steps, so that both meet
the same state of the machine, and each measures the CPU time of `env.step` (with goals, planner and controller
included; resets and warm-up excluded). Blocks in which a function was compiled or loaded do not count, in either tree.
Simulators of the extra `peers` are measured after that (`peers.py`).
"""

from __future__ import annotations

import contextlib
import itertools
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks import peers
from benchmarks.common import Figures, Options, ratio
from benchmarks.tables import table
from benchmarks.trees import WORKING_TREE, TreeWorker, checkout, tree_worker

ACTIONS, SWEEPS = ("random", "breadth_first"), (1, 4)
HERE = "working tree"


@dataclass(frozen=True, slots=True)
class Sizes:
    """How much is driven, in control steps per tree."""

    block: int = 100
    episode: int = 1000  # it may end earlier by itself
    warm_up: int = 300
    total: int = 6000


QUICK = Sizes(block=50, warm_up=100, total=500)


def run(options: Options, sizes: Sizes | None = None) -> Figures:
    """For each number of sweeps and kind of action the ratio of the step times, new to old; then the peers."""
    assert options.against is not None
    sizes = sizes or (QUICK if options.quick else Sizes())
    with checkout(options.against) as other:
        trees = {HERE: WORKING_TREE, options.against: other}
        figures: Figures = {
            f"K={k}": {actions: compare(trees, actions, k, sizes) for actions in ACTIONS} for k in SWEEPS
        }
    return {"against": options.against, **figures, "peers": peers.measure(sizes.total // sizes.block, SWEEPS)}


def compare(trees: dict[str, Path], actions: str, sweeps: int, sizes: Sizes) -> Figures:
    """The figures of one kind of action."""
    with contextlib.ExitStack() as stack:
        workers = [stack.enter_context(tree_worker(name, tree, actions, str(sweeps))) for name, tree in trees.items()]
        return summarise(list(measure(workers, sizes)))


def measure(workers: list[TreeWorker], sizes: Sizes) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Pairs of blocks (new, old), which are in the same place of the same episode as long as both trees agree."""
    for worker in workers:
        worker.check_package()
        worker.call("reset", 0)
        worker.call("drive", sizes.warm_up)
    for worker in workers:
        worker.call("pin", max(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 0)
    steps, turns = 0, itertools.cycle([(0, 1), (1, 0)])
    for seed in itertools.count(1):
        for worker in workers:
            worker.call("reset", seed)
        for _ in range(0, sizes.episode, sizes.block):
            blocks = {turn: workers[turn].call("drive", sizes.block) for turn in next(turns)}
            steps += blocks[0]["steps"]
            yield blocks[0], blocks[1]
            if steps >= sizes.total:
                return
            if blocks[0]["over"] or blocks[1]["over"]:
                break


def summarise(pairs: list[tuple[dict[str, Any], dict[str, Any]]]) -> Figures:
    """Ratio of the times per step with its interval over the pairs of blocks; steps per second; equal results."""
    counted = [pair for pair in pairs if not (pair[0]["compiled"] or pair[1]["compiled"])]
    new, old = ([block["seconds"] / block["steps"] for block in blocks] for blocks in zip(*counted, strict=True))
    return {
        "ratio": ratio(new, old),
        "steps_per_s": len(new) / sum(new),
        "steps_per_s_against": len(old) / sum(old),
        "left_out": len(pairs) - len(counted),  # pairs in which something was compiled
        "same_observations": sum(a["digest"] == b["digest"] for a, b in pairs) / len(pairs),
    }


def report(figures: Figures) -> str:
    """One row for each kind of action."""
    ref = figures["against"]
    columns = ("ratio", "steps_per_s", "steps_per_s_against", "same_observations")
    rows = [
        (sweeps, actions, *(values[name] for name in columns), values["ratio"]["n"])
        for sweeps, kinds in figures.items()
        if sweeps.startswith("K=")
        for actions, values in kinds.items()
    ]
    head = ["sweeps", "actions", f"time per step, {HERE} / {ref}", f"steps per second, {HERE}"]
    head += [f"steps per second, {ref}", "share with the same observation", "pairs of blocks"]
    return f"{table(head, rows)}\n\n## MiniGrid and ir-sim\n\n{peers.report(figures.get('peers', {}))}"
