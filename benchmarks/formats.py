"""What a control step costs in each format of the observation, and how many of the offered goals `flat` describes.

One environment per format in one process, driven with the same random actions in short blocks that alternate, so that
other load affects all formats alike. A ratio is taken within a round and compares the CPU time per control step with
that of the format "dict"; "none" leaves the observation out, so that no format can be cheaper. In the paper's building
and in generated ones of `Rooms-v0` (medium), with velocities and with goals (a valid row each time).

`described` is the share of the goals offered at a decision that `flat` describes, `offered` their number per decision,
in whole episodes of random goals.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import gymnasium

import mecp_env
from benchmarks.common import Figures, Options, estimate, in_rounds, share
from benchmarks.random_actions import RandomDriver, goal, velocity

BUILDINGS: dict[str, dict[str, Any]] = {
    "PaperMap": {"id": "mecp_env/PaperMap-v0"},
    "Rooms, medium": {"id": "mecp_env/Rooms-v0", "difficulty": "medium"},
}
OFFERED = BUILDINGS | {
    "Rooms, hard": {"id": "mecp_env/Rooms-v0", "difficulty": "hard"},
    "ActiveHalls": {"id": "mecp_env/ActiveHalls-v0"},
}
FORMATS = ("dict", "flat", "image", "none")
BLOCK = {"velocity": 100, "goal": 6}  # actions


def run(options: Options) -> Figures:
    """All results: 30 rounds of blocks, and 10 episodes of each building (--quick: 4 and 1)."""
    rounds, episodes = (4, 1) if options.quick else (30, 10)
    times = {f"{name}, {actions}": compare(name, actions, rounds) for name in BUILDINGS for actions in BLOCK}
    return {"time": times, "rows": {name: rows_described(name, episodes) for name in OFFERED}}


def compare(name: str, actions: str, rounds: int) -> Figures:
    """Milliseconds per control step of each format, and their ratios to "dict", over the rounds after the first."""
    drivers = {word: driver_of(name, actions, word) for word in FORMATS}
    blocks = {word: partial(driver.seconds_per_step, BLOCK[actions]) for word, driver in drivers.items()}
    seconds = in_rounds(blocks, rounds)
    ratios = {word: estimate(seconds[word] / seconds["dict"]) for word in FORMATS[1:]}
    return {"dict_ms": estimate(1e3 * seconds["dict"]), **ratios}


def driver_of(name: str, actions: str, observation: str) -> RandomDriver:
    """An environment with a format of the observation."""
    env = make(name, actions=actions, observation="dict" if observation == "none" else observation)
    if observation == "none":
        env.unwrapped.observation = dict
    return RandomDriver(env, velocity if actions == "velocity" else goal)


def make(name: str, **fields: Any) -> Any:
    """The environment of a building, without Gymnasium's checks of each step."""
    env: Any = gymnasium.make(**OFFERED[name], disable_env_checker=True, **fields)
    return env.env  # without the check of the order of reset and step


def rows_described(name: str, episodes: int) -> Figures:
    """The share of offered rows whose column `valid` is 1, over all decisions of some episodes of random goals."""
    env = make(name, actions="goal", observation="flat")
    valid = [k for k, column in enumerate(mecp_env.flat_names(env)) if column.endswith("_valid")]
    env.action_space.seed(0)
    described, decisions = list[bool](), 0
    for seed in range(episodes):
        (observation, info), over = env.reset(seed=seed), False
        while not over:
            described += (observation[valid][info["action_mask"] == 1] == 1.0).tolist()
            decisions += 1
            observation, _, ended, cut, info = env.step(env.action_space.sample(mask=info["action_mask"]))
            over = ended or cut
    return {"described": share(described), "offered": len(described) / decisions, "decisions": decisions}
