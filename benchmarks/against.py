"""`speed --against GIT_REF`: step time of the working tree and of another commit, in alternating blocks on one core.

Two processes, one in each tree, drive the same episodes. They take turns in blocks of control steps, so that both meet
the same state of the machine, and each measures the CPU time of `env.step` (with goals, planner and controller
included; resets and warm-up excluded). Blocks in which a function was compiled or loaded do not count, in either tree.
Simulators of the extra `peers` are measured after that (`peers.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from benchmarks import peers
from benchmarks.common import Figures, Options, ratio
from benchmarks.in_tree import ACTIONS, SWEEPS
from benchmarks.tables import one_table
from benchmarks.trees import HERE, in_turns_by_tree, run_in

BLOCK, WARM_UP, BLOCKS = 100, 300, 6  # control steps; blocks of a turn
TURNS, QUICK_TURNS = 12, 2
PEER_TURNS, QUICK_PEER_TURNS = 60, 5


def run(options: Options) -> Figures:
    """For each number of sweeps and kind of action the ratio of the step times, new to old; then the peers."""
    assert options.against is not None
    turns, peer_turns = (QUICK_TURNS, QUICK_PEER_TURNS) if options.quick else (TURNS, PEER_TURNS)
    pairs = list(zip(*in_turns_by_tree(options, turns, drive).values(), strict=True))
    figures: Figures = {
        f"K={k}": {
            kind: summarise([tuple(turn[f"K={k} {kind}"] for turn in pair) for pair in pairs]) for kind in ACTIONS
        }
        for k in SWEEPS
    }
    return {"against": options.against, **figures, "peers": peers.measure(peer_turns, SWEEPS)}


def drive(tree: Path) -> Figures:
    """What a tree drives in a turn."""
    return run_in(tree, "drive", *map(str, (WARM_UP, BLOCK, BLOCKS)))


def summarise(pairs: Sequence[Sequence[Figures]]) -> Figures:
    """Ratio of the times per step with its interval over the turns; steps per second; equal results."""
    counted = [pair for pair in pairs if all(turn["steps"] for turn in pair)]
    new, old = ([turn["seconds"] / turn["steps"] for turn in turns] for turns in zip(*counted, strict=True))
    return {
        "ratio": ratio(new, old),
        "steps_per_s": len(new) / sum(new),
        "steps_per_s_against": len(old) / sum(old),
        "same_observations": sum(a["digest"] == b["digest"] for a, b in pairs) / len(pairs),
    }


def report(figures: Figures) -> str:
    """One row for each number of sweeps and kind of action."""
    said = f"`ratio` is the time per step of the {HERE} over that of {figures['against']}, from pairs of blocks."
    ours = one_table({name: of for name, of in figures.items() if name.startswith("K=")})
    return f"{said}\n\n{ours}\n\n## MiniGrid and ir-sim\n\n{peers.report(figures.get('peers', {}))}"
