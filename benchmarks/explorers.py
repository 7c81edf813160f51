"""Explorers: breadth first against a random walk, from a start given by the seed.

A seed is complete when its episode terminates with every room and every door found and 95 % of the free area seen. A
room is found when it contains the centre of a room of the map, a door when a door of the map lies within 0.3 m, one to
one; other rooms and doors of the map are false. An episode is lost when the pose is more than 1 m or 10 degrees off for
20 control steps in a row or at the end, or has diverged. Steps and metres to a coverage are means over the seeds that
reached it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.columns import of_visits
from benchmarks.common import Figures, Gate, Options, estimate, grouped, in_parallel, share
from benchmarks.tables import sections, turned
from benchmarks.worlds import COMPLETE_COVERAGE, found_all
from mecp_env.policies.registry import make_policy
from mecp_env.registration import make
from mecp_env.wrappers import GoalActions

EXPLORERS = {
    "breadth first": "bfs",
    "random walk": "random_walk",
}
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


@dataclass(slots=True)
class Episode:
    """One exploration: its final figures, and when each coverage was reached."""

    final: dict[str, float] = field(default_factory=dict)
    steps: dict[float, float] = field(default_factory=lambda: dict.fromkeys(LEVELS, float("nan")))
    metres: dict[float, float] = field(default_factory=lambda: dict.fromkeys(LEVELS, float("nan")))

    def look(self, info: dict[str, Any]) -> None:
        """Record the info of one control step."""
        for level in LEVELS:
            if np.isnan(self.steps[level]) and info["coverage"] >= level:
                self.steps[level], self.metres[level] = info["period"], info["metres"]


def run(options: Options) -> Figures:
    """Results of every layout and explorer."""
    seeds = QUICK if options.quick else SEEDS
    tasks = [(layout, name, seed) for layout in seeds for name in EXPLORERS for seed in range(seeds[layout])]
    figures: Figures = {layout: {} for layout in seeds}
    for (layout, name), episodes in grouped(tasks, in_parallel(explore, Episode, tasks, options)).items():
        figures[layout][name] = summarise(episodes)
    return figures


def explore(task: tuple[str, str, int]) -> Episode:
    """One episode: the layout, the name of the explorer, the seed."""
    layout, name, seed = task
    agent = make_policy(EXPLORERS[name])
    env = make(layout=layout, actions=agent.actions, max_steps=MAX_STEPS, start="random")
    episode = Episode()
    if isinstance(env, GoalActions):
        env.callback = lambda step: episode.look(step[4])
    agent.reset(seed)
    observation, info = env.reset(seed=seed)
    terminated = truncated = False
    while not (terminated or truncated):
        episode.look(info)
        action = agent.act(observation, env.action_masks() if isinstance(env, GoalActions) else None)
        observation, _, terminated, truncated, info = env.step(action)
    episode.look(info)
    episode.final = env.get_wrapper_attr("summary")()
    return episode


def is_complete(final: dict[str, float]) -> bool:
    """True when every room and door was found and 95 % of the free area was seen."""
    return found_all(final) and final["coverage"] >= COMPLETE_COVERAGE


def summarise(episodes: list[Episode]) -> Figures:
    """Results of one explorer on one layout, each with its 95 % interval."""
    finals = [episode.final for episode in episodes]

    figures: Figures = {"complete": share(map(is_complete, finals)), "lost": share(final["lost"] for final in finals)}
    figures |= of_visits(finals, TOTALS)
    for level in LEVELS:
        figures[f"reached_{level:.0%}"] = share(not np.isnan(episode.steps[level]) for episode in episodes)
        figures[f"periods_to_{level:.0%}"] = estimate([episode.steps[level] for episode in episodes])
        figures[f"metres_to_{level:.0%}"] = estimate([episode.metres[level] for episode in episodes])
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
