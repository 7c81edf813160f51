"""The cost of a larger building and of pedestrians, relative to a step in the empty `paper` layout of the same run.

The building is a generated one of the preset `hard`, test split, with at least 200 wall faces (the layout `paper` has
98). A pedestrian is a polygon with 16 faces for the laser. Settings are measured in alternating blocks, so that other
load affects all of them. Each block is an exploration (or a random drive) with its own start; a ratio compares the time
per step in two blocks of the same turn.
"""

from __future__ import annotations

from functools import cache
from itertools import count, islice
from typing import Any

import numpy as np

from benchmarks.common import Figures, estimate
from benchmarks.drives import exploration
from benchmarks.random_actions import wander
from benchmarks.records import Course
from benchmarks.stopwatch import timed_stages
from mecp_env.env import MecpEnv
from mecp_env.world.outline import build_outline
from mecp_env.world.schema import Layout
from mecp_env.wrappers import GoalActions

LEAST_FACES = 200
PEOPLE = {"crowd": {"people": 8}}
BARE = "paper"
SETTINGS: dict[str, tuple[bool, dict[str, Any]]] = {  # whether in the generated building, and its dynamic obstacles
    BARE: (False, {}),
    "paper, 8 people": (False, PEOPLE),
    "200 walls": (True, {}),
    "200 walls, 8 people": (True, PEOPLE),
}
ACTIONS = ("random", "bfs")
RANDOM_STEPS, MAX_STEPS = 400, 3000  # of a random drive and of an exploration


def measure(turns: int) -> Figures:
    """For random actions and the explorer: us per step in each setting, and its ratio to the empty layout.

    `us` are those of an environment step, `with_driver_us` with planner and controller.
    """
    figures: Figures = {}
    for actions in ACTIONS:
        us = {name: np.array([block(name, actions, turn) for turn in range(-1, turns)][1:]).T for name in SETTINGS}
        figures[actions] = {
            name: {
                f"{prefix}{figure}": estimate(value)
                for prefix, own, bare in zip(("", "with_driver_"), of, us[BARE], strict=True)
                for figure, value in (("us", own), ("ratio", own / bare))
            }
            for name, of in us.items()
        }
    return figures


def block(setting: str, actions: str, turn: int) -> tuple[float, float]:
    """Microseconds per step of one drive in a setting, without and with planner and controller."""
    generated, moving = SETTINGS[setting]
    layout = building(max(turn, 0)) if generated else BARE
    env = MecpEnv(layout=layout, start="random", max_steps=MAX_STEPS, **moving)
    with timed_stages(each=False) as watch:
        if actions == "random":
            wander(env, RANDOM_STEPS, turn + 1)
        else:
            for _ in exploration(GoalActions(env), turn + 1):
                pass
    step, with_driver = watch.seconds["step"], watch.seconds["step"] + watch.seconds["drive"]
    return 1e6 * step / watch.steps, 1e6 * with_driver / watch.steps


@cache
def building(number: int) -> Layout:
    """The generated building of a turn, among those with enough wall faces."""
    layouts = (Course(f"hard:{index}", 0).building() for index in count())
    large = (layout for layout in layouts if len(build_outline(layout).segments) >= LEAST_FACES)
    return next(islice(large, number, None))
