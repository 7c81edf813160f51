"""Explorers: breadth first against a random walk, from a start given by the seed.

A seed is complete when its episode terminates with every room and every door found and 95 % of the free area seen. A
room is found when it contains the centre of a room of the map, a door when a door of the map lies within 0.3 m, one to
one; other rooms and doors of the map are false. An episode is lost when the pose is more than 1 m or 10 degrees off for
20 control steps in a row or at the end, or has diverged. Steps and metres to a coverage are means over the seeds that
reached it.
"""

from __future__ import annotations

import math

from benchmarks.common import Figures, Gate, Options, estimate, grouped, in_parallel, share
from benchmarks.tables import of_visits, sections, turned
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
    *("coverage", "rooms_found", "rooms_false", "doors_found", "doors_false", "door_error_m", "polygon_cover"),
    *("grid_cover", "grid_iou", "periods", "metres", "contacts_per_100_m", "pose_rmse_m", "nees", "map_rmse_m"),
    *("landmarks_false", "duplicates"),
)

GATES = (
    Gate("paper/breadth first/complete", "share", 0.03),
    Gate("paper/breadth first/coverage", "share", 0.01),
    Gate("paper/breadth first/rooms_found", "share", 0.02),
    Gate("paper/breadth first/doors_found", "share", 0.02),
    Gate("paper/breadth first/periods_to_90%", "error", 1.15),
    Gate("paper/breadth first/contacts_per_100_m", "error", 1.5),
)


def run(options: Options) -> Figures:
    """Results of every layout and explorer."""
    seeds = QUICK if options.quick else SEEDS
    tasks = [(layout, name, seed) for layout in seeds for name in EXPLORERS for seed in range(seeds[layout])]
    figures: Figures = {layout: {} for layout in seeds}
    for (layout, name), episodes in grouped(tasks, in_parallel(explore, dict[str, float], tasks, options)).items():
        figures[layout][name] = summarise(episodes)
    return figures


def explore(task: tuple[str, str, int]) -> dict[str, float]:
    """Final figures of one episode, and when each coverage was reached: the layout, the explorer, the seed."""
    layout, name, seed = task
    agent, curve = make_policy(EXPLORERS[name]), CoverageCurve()
    env = make(layout=layout, actions=agent.actions, max_steps=MAX_STEPS, start="random", info_texts=True)
    run_policy(env, agent, lambda info: curve.add(info["metres"], info["period"], info["coverage"]), (0, seed))
    final: dict[str, float] = env.get_wrapper_attr("summary")()
    for level in LEVELS:
        final[f"periods_to_{level:.0%}"] = curve.steps_to(level, math.nan)
        final[f"metres_to_{level:.0%}"] = curve.metres_to(level, math.nan)
    return final


def is_complete(final: dict[str, float]) -> bool:
    """True when every room and door was found and 95 % of the free area was seen."""
    return found_all(final) and final["coverage"] >= COMPLETE_COVERAGE


def summarise(finals: list[dict[str, float]]) -> Figures:
    """Results of one explorer on one layout, each with its 95 % interval."""
    figures: Figures = {"complete": share(map(is_complete, finals)), "lost": share(final["lost"] for final in finals)}
    figures |= of_visits(finals, TOTALS)
    for level in LEVELS:
        figures[f"reached_{level:.0%}"] = share(final[f"periods_to_{level:.0%}"] < math.inf for final in finals)
        for unit in ("periods", "metres"):
            name = f"{unit}_to_{level:.0%}"
            figures[name] = estimate([final[name] for final in finals])
    figures["incomplete_seeds"] = [seed for seed, final in enumerate(finals) if not is_complete(final)]
    return figures


def report(figures: Figures) -> str:
    """One table per layout."""
    return sections(
        {
            f"{layout}, {next(iter(explorers.values()))['complete']['n']} seeds": turned(explorers)
            for layout, explorers in figures.items()
        }
    )
