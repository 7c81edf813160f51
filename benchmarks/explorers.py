"""Explorers: breadth first against a random walk, from a start given by the seed.

A seed is complete when its episode terminates with every room and every door found and 95 % of the free area seen. A
room is found when it contains the centre of a room of the map, a door when a door of the map lies within 0.3 m, one to
one; other rooms and doors of the map are false. An episode is lost when the pose is more than 1 m or 10 degrees off for
20 control steps in a row or at the end, or has diverged. Steps and metres to a coverage are means over the seeds that
reached it.
"""

from __future__ import annotations

import math

from benchmarks.common import Figures, Options, grouped, in_parallel
from benchmarks.tables import of_visits
from benchmarks.worlds import COMPLETE_COVERAGE, found_all
from mecp_env.policies.registry import make_policy
from mecp_env.policies.rollout import CoverageCurve, run_policy
from mecp_env.registration import make

EXPLORERS = {"breadth first": "bfs", "random walk": "random_walk"}
SEEDS = {"paper": 50, "two_rooms": 15, "office": 15, "twins": 15, "furnished": 15}
QUICK = {"paper": 2, "two_rooms": 3}
LEVELS = (0.90, 0.99)
MAX_STEPS = 3000
TOTALS = (
    *("complete", "lost", "coverage", "rooms_found", "rooms_false", "doors_found", "doors_false", "door_error_m"),
    *("polygon_cover", "grid_cover", "grid_iou", "periods", "metres", "contacts_per_100_m", "pose_rmse_m", "nees"),
    *("map_rmse_m", "landmarks_false", "duplicates"),
    *(f"{name}_{level:.0%}" for level in LEVELS for name in ("reached", "periods_to", "metres_to")),
)


def run(options: Options) -> Figures:
    """Results of every layout and explorer."""
    seeds = QUICK if options.quick else SEEDS
    tasks = [(layout, name, seed) for layout in seeds for name in EXPLORERS for seed in range(seeds[layout])]
    figures: Figures = {layout: {} for layout in seeds}
    for (layout, name), episodes in grouped(tasks, in_parallel(explore, dict[str, float], tasks, options)).items():
        incomplete = [seed for seed, final in enumerate(episodes) if not final["complete"]]
        figures[layout][name] = of_visits(episodes, TOTALS) | {"incomplete_seeds": incomplete}
    return figures


def explore(task: tuple[str, str, int]) -> dict[str, float]:
    """Final figures of one episode, and when each coverage was reached: the layout, the explorer, the seed.

    It is complete when every room and door was found and 95 % of the free area was seen.
    """
    layout, name, seed = task
    agent, curve = make_policy(EXPLORERS[name]), CoverageCurve()
    env = make(layout=layout, actions=agent.actions, max_steps=MAX_STEPS, start="random", info_texts=True)
    run_policy(env, agent, lambda info: curve.add(info["metres"], info["period"], info["coverage"]), (0, seed))
    final: dict[str, float] = env.get_wrapper_attr("summary")()
    final["complete"] = found_all(final) and final["coverage"] >= COMPLETE_COVERAGE
    for level in LEVELS:
        final[f"periods_to_{level:.0%}"] = curve.steps_to(level, math.nan)
        final[f"metres_to_{level:.0%}"] = curve.metres_to(level, math.nan)
        final[f"reached_{level:.0%}"] = math.isfinite(final[f"periods_to_{level:.0%}"])
    return final
