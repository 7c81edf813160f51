"""`speed --against GIT_REF`: step time of the working tree and of another commit, in alternating blocks on one core.

Two processes, one in each tree, drive the same episodes. They take turns in blocks of control steps, so that both meet
the same state of the machine, and each measures the CPU time of `env.step` (with goals, planner and controller
included; resets and warm-up excluded). Blocks in which a function was compiled or loaded do not count, in either tree.
Simulators of the extra `peers` are measured after that (`peers.py`).
"""

from __future__ import annotations

import contextlib
import os
from functools import partial
from pathlib import Path

from benchmarks import peers
from benchmarks.common import Figures, Options, in_turns, ratio
from benchmarks.tables import table
from benchmarks.trees import WORKING_TREE, checkout, tree_worker

ACTIONS, SWEEPS = ("random", "breadth_first"), (1, 4)
HERE = "working tree"
BLOCK, WARM_UP = 100, 300  # control steps
BLOCKS, QUICK_BLOCKS = 60, 5


def run(options: Options) -> Figures:
    """For each number of sweeps and kind of action the ratio of the step times, new to old; then the peers."""
    assert options.against is not None
    blocks = QUICK_BLOCKS if options.quick else BLOCKS
    with checkout(options.against) as other:
        trees = {HERE: WORKING_TREE, options.against: other}
        figures: Figures = {
            f"K={k}": {actions: compare(trees, actions, k, blocks) for actions in ACTIONS} for k in SWEEPS
        }
    return {"against": options.against, **figures, "peers": peers.measure(blocks, SWEEPS)}


def compare(trees: dict[str, Path], actions: str, sweeps: int, blocks: int) -> Figures:
    """The figures of one kind of action."""
    with contextlib.ExitStack() as stack:
        workers = [stack.enter_context(tree_worker(name, tree, actions, str(sweeps))) for name, tree in trees.items()]
        for worker in workers:
            worker.call("drive", WARM_UP)
        for worker in workers:
            worker.call("pin", max(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 0)
        turns = in_turns({worker.name: partial(worker.call, "drive", BLOCK) for worker in workers}, blocks)
    new, old = trees
    return summarise([(turn[new], turn[old]) for turn in turns])


def summarise(pairs: list[tuple[Figures, Figures]]) -> Figures:
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
