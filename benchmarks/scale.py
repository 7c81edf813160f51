"""Scale: what a step costs with 55, 300, 688 and 1,000 landmarks, in generated buildings of 200 rooms.

A building is explored breadth first, and the state is kept at so many landmarks in the map. Each state is continued
for some steps, one state after the other and round again, so that other load on the machine affects all of them. A
ratio compares the time per step in two blocks of the same round; the mean over the rounds is one figure per building.
Times are CPU times of this thread, planner included.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.common import Figures, Gate, Options, chosen, grouped, in_parallel
from benchmarks.tables import table
from mecp_env.cli.stopwatch import timed_stages
from mecp_env.core.intervals import estimate
from mecp_env.env import MecpEnv
from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.world.generator import GeneratorSpec, generate
from mecp_env.wrappers import GoalActions

FILTERS = ("riekf", "riekf_submaps")
COUNTS = (55, 300, 688, 1000)
QUICK = (55, 300)
BUILDING: dict[str, Any] = {"rooms": 200, "loops": 40, "corridors": 20, "shaped_rooms": 20, "furniture": 0.5}
BUILDINGS, ROUNDS, BLOCK = 4, 4, 250
SETS, MOST = dict.fromkeys(FILTERS, BUILDINGS), 100
MOST_STEPS = 100_000

GATES = (
    Gate("riekf_submaps/688/ratio", "bound", 2.0),
    Gate("riekf_submaps/1000/ratio", "bound", 2.5),
)


def run(options: Options) -> Figures:
    """Results of the filters at each number of landmarks; --quick: one building, 55 and 300 landmarks."""
    buildings = chosen(options.sets, SETS, MOST) or SETS
    counts, buildings = (QUICK, dict.fromkeys(buildings, 1)) if options.quick else (COUNTS, buildings)
    tasks = [(kind, max(counts), seed) for kind in buildings for seed in range(buildings[kind])]
    results = grouped(tasks, in_parallel(measure, dict[str, list[float]], tasks, options))
    return {kind: summarise(of_kind) for (kind, _), of_kind in results.items()}


def measure(task: tuple[str, int, int]) -> dict[str, list[float]]:
    """Microseconds per step by number of landmarks, one for each round, in one building."""
    kind, most, seed = task
    layout = generate(GeneratorSpec.preset("easy", **BUILDING), seed)
    env = GoalActions(MecpEnv(layout=layout, start="random", max_steps=MOST_STEPS, slam={"filter": {"kind": kind}}))
    states = explored(env, seed, [count for count in COUNTS if count <= most])
    rounds = [{count: block(env, state) for count, state in states.items()} for _ in range(-1, ROUNDS)]
    return {str(count): [us[count] for us in rounds[1:]] for count in states}  # without the first, a warm-up


def explored(env: GoalActions, seed: int, counts: list[int]) -> dict[int, dict[str, Any]]:
    """The state of an exploration when its map had so many landmarks."""
    states, policy = dict[int, dict[str, Any]](), BreadthFirst()
    observation, _ = env.reset(seed=seed)
    for count in counts:
        while len(env.base.slam_output.belief.ids) < count:
            observation, _, terminated, truncated, _ = env.step(policy.act(observation, env.action_masks()))
            if terminated or truncated:
                return states
        states[count] = env.base.get_state()
    return states


def block(env: GoalActions, state: dict[str, Any]) -> float:
    """Microseconds per step from a state on."""
    policy, periods = BreadthFirst(), 0
    env.base.set_state(state)
    observation = env.base.observation()
    with timed_stages(each=False) as watch:
        while periods < BLOCK:
            observation, _, terminated, truncated, info = env.step(policy.act(observation, env.action_masks()))
            periods += info["periods"]
            if terminated or truncated:
                break
    return 1e6 * (watch.seconds["step"] + watch.seconds["drive"]) / watch.steps


def summarise(buildings: list[dict[str, list[float]]]) -> Figures:
    """By number of landmarks: time per step, and its ratio to the smallest map of the same round."""
    figures: Figures = {}
    for count in buildings[0]:
        us = [np.array(found[count]) for found in buildings if count in found]
        few = [np.array(found[str(COUNTS[0])]) for found in buildings if count in found]
        ratios = [float(np.mean(a / b)) for a, b in zip(us, few, strict=True)]
        figures[count] = {"us": estimate([float(a.mean()) for a in us]), "ratio": estimate(ratios)}
    return figures


def report(figures: Figures) -> str:
    """One table."""
    counts = list(next(iter(figures.values())))
    rows = [
        (f"{kind}, {name}", *(of_kind[count][name] for count in counts))
        for kind, of_kind in figures.items()
        for name in ("us", "ratio")
    ]
    return table(["", *counts], rows)
