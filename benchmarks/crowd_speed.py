"""The cost of a larger building and of pedestrians, relative to a step in the empty `paper` layout of the same run.

The building is a generated one of the preset `hard`, test split, with at least 200 wall faces (the layout `paper` has
98). A pedestrian is a polygon with 16 faces for the laser. Settings are measured in alternating blocks, so that other
load affects all of them. Each block is an exploration (or a random drive) with its own start; a ratio compares the time
per step in two blocks of the same turn.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np

from benchmarks.common import Figures, estimate
from benchmarks.drives import drive_at_random, exploration
from benchmarks.stopwatch import Stopwatch, timed_stages
from benchmarks.tables import table_of
from mecp_env.env import MecpEnv
from mecp_env.world.config import GeneratorSpec, split_seed
from mecp_env.world.generator import generate
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
RANDOM_STEPS = 400  # of a random drive
MAX_STEPS = 3000


def measure(turns: int) -> Figures:
    """For random actions and the explorer: us per step in each setting, and its ratio to the empty layout."""
    drives = {"random": partial(drive_at_random, steps=RANDOM_STEPS), "bfs": explore}
    return {name: compared(drive, turns) for name, drive in drives.items()}


def compared(drive: Callable[..., None], turns: int) -> Figures:
    """`us` per environment step, `with_driver_us` with planner and controller, and their ratios to the empty layout."""
    blocks = [{name: block(name, drive, turn) for name in SETTINGS} for turn in range(-1, turns)][1:]  # one for warm-up
    return {name: figures([(turn[name], turn[BARE]) for turn in blocks]) for name in SETTINGS}


def figures(pairs: list[tuple[Stopwatch, Stopwatch]]) -> Figures:
    """The figures of a setting from its blocks, each paired with a block of the empty layout."""
    seconds = np.array([[(watch.seconds["step"], watch.seconds["drive"]) for watch in pair] for pair in pairs])
    us = 1e6 * seconds / np.array([[[watch.steps] for watch in pair] for pair in pairs])
    found: Figures = {}
    for prefix, of in {"": us[:, :, 0], "with_driver_": us.sum(axis=2)}.items():
        found |= {f"{prefix}us": estimate(of[:, 0]), f"{prefix}ratio": estimate(of[:, 0] / of[:, 1])}
    return found


def block(setting: str, drive: Callable[..., None], turn: int) -> Stopwatch:
    """One drive in a setting, timed."""
    generated, moving = SETTINGS[setting]
    layout = building(max(turn, 0)) if generated else BARE
    env = MecpEnv(layout=layout, start="random", max_steps=MAX_STEPS, **moving)
    with timed_stages(each=False) as watch:
        drive(env, seed=turn + 1)
    return watch


@cache
def building(number: int) -> Layout:
    """The generated building of a turn, among those with enough wall faces."""
    spec, index, found = GeneratorSpec.preset("hard"), -1, -1
    while found < number:
        index += 1
        layout = generate(spec, split_seed("test", index))
        found += len(build_outline(layout).segments) >= LEAST_FACES
    return layout


def report(measured: Figures) -> str:
    """One table with one row per setting."""
    columns = ("us", "with_driver_us", "ratio", "with_driver_ratio")
    rows = {f"{actions}, {setting}": of for actions, settings in measured.items() for setting, of in settings.items()}
    return table_of("actions, where", columns, rows)


def explore(env: MecpEnv, seed: int) -> None:
    """One whole exploration."""
    for _ in exploration(GoalActions(env), seed):
        pass
