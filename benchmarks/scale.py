"""Scale: what a step costs with 55, 300, 688 and 1,000 landmarks, in generated buildings of 200 rooms, and the drift.

A building is explored breadth first, and the state is kept at so many landmarks in the map. Each state is continued
for some steps, one state after the other and round again, so that other load on the machine affects all of them. A
ratio compares the time per step in two blocks of the same round; the mean over the rounds is one figure per building.
Times are CPU times of this thread, planner included.

The exploration goes on to 12,000 steps. Its pose errors (median and 95 % quantile over the steps) and the share of the
steps in which the pose is searched for show what long corridors cost, in which a scan has few corners or none. `blind`
is `riekf_submaps` with `panorama.use = "blind"`: such scans are not registered with recent ones.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.common import Figures, Options, estimate, grouped, in_parallel, runs_of
from benchmarks.drives import exploration
from benchmarks.stopwatch import timed_stages
from mecp_env.env import MecpEnv
from mecp_env.world.config import GeneratorSpec
from mecp_env.world.generator import generate
from mecp_env.wrappers import GoalActions

KINDS: dict[str, dict[str, Any]] = {
    "riekf": {"filter": {"kind": "riekf"}},
    "riekf_submaps": {"filter": {"kind": "riekf_submaps"}},
    "blind": {"filter": {"kind": "riekf_submaps"}, "panorama": {"use": "blind"}},
}
COUNTS, QUICK = (55, 300, 688, 1000), (55, 300)
BUILDING: dict[str, Any] = {"rooms": 200, "loops": 40, "corridors": 20, "shaped_rooms": 20, "furniture": 0.5}
BUILDINGS, ROUNDS, BLOCK = 4, 4, 250
SETS = dict.fromkeys(KINDS, BUILDINGS)
MOST_STEPS, STEPS = 100_000, 12_000
DRIFT, COLUMNS = "drift", ("median_m", "q95_m", "lost")
Drift = list[tuple[float, bool]]  # pose error in m, and whether the pose is known, in each step of an exploration


def run(options: Options) -> Figures:
    """Results of each kind at each number of landmarks; --quick: one building, 55 and 300 landmarks."""
    most = max(QUICK if options.quick else COUNTS)
    tasks = [(kind, most, seed) for kind, seed in runs_of(options, SETS, quick=1)]
    results = grouped(tasks, in_parallel(measure, dict[str, list[float]], tasks, options))
    return {kind: summarise(of_kind) for (kind, _), of_kind in results.items()}


def measure(task: tuple[str, int, int]) -> dict[str, list[float]]:
    """Microseconds per step by number of landmarks, one for each round, and the drift, in one building.

    That is the median and the 95 % quantile of the pose error, m, and the share of the steps without a known pose.
    """
    kind, most, seed = task
    layout = generate(GeneratorSpec.preset("easy", **BUILDING), seed)
    env = GoalActions(MecpEnv(layout=layout, start="random", max_steps=MOST_STEPS, slam=KINDS[kind]))
    states, drift = explored(env, seed, [count for count in COUNTS if count <= most])
    rounds = [{count: block(env, state) for count, state in states.items()} for _ in range(-1, ROUNDS)]
    us = {str(count): [us[count] for us in rounds[1:]] for count in states}  # without the first, a warm-up
    errors, known = np.array(drift).T
    return us | {DRIFT: [*np.quantile(errors, [0.5, 0.95]).tolist(), float(1.0 - known.mean())]}


def explored(env: GoalActions, seed: int, counts: list[int]) -> tuple[dict[int, dict[str, Any]], Drift]:
    """The state of an exploration when its map had so many landmarks, and its drift up to `STEPS`."""
    states, drift, left = dict[int, dict[str, Any]](), Drift(), list(counts)
    env.callback, env.observes = lambda step: drift.append((step[4]["pose_error_m"], step[4]["localised"])), False
    for _, _, terminated, truncated, _ in exploration(env, seed):
        if left and not (terminated or truncated) and len(env.base.slam_output.belief.ids) >= left[0]:
            states[left.pop(0)] = env.base.get_state()
        if not left and len(drift) >= STEPS:
            break
    env.callback, env.observes = None, True
    return states, drift[:STEPS]


def block(env: GoalActions, state: dict[str, Any]) -> float:
    """Microseconds per step from a state on."""
    env.base.set_state(state)
    periods = 0
    with timed_stages(each=False) as watch:
        for *_, info in exploration(env, None):
            periods += info["periods"]
            if periods >= BLOCK:
                break
    return 1e6 * (watch.seconds["step"] + watch.seconds["drive"]) / watch.steps


def summarise(buildings: list[dict[str, list[float]]]) -> Figures:
    """By number of landmarks: time per step, and its ratio to the smallest map of the same round; then the drift."""
    drifts = zip(*(found.pop(DRIFT) for found in buildings), strict=True)
    figures: Figures = {DRIFT: {name: estimate(list(values)) for name, values in zip(COLUMNS, drifts, strict=True)}}
    for count in buildings[0]:
        us, few = (np.array([of[n] for of in buildings if count in of]) for n in (count, str(COUNTS[0])))
        figures[count] = {"us": estimate(us.mean(axis=1)), "ratio": estimate((us / few).mean(axis=1))}
    return figures
