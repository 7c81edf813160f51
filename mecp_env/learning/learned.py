"""Trained policies as agents: `load("maskable_ppo")`, or the folder of a run. Nothing that is loaded can run code.

A policy is built from its configuration and then given its weights, which are tensors and nothing else. A model file
of Stable-Baselines3 (a zip with a pickle in it) is code: it is refused unless whoever calls says that he trusts it.

`python -m mecp_env.learning.learned NAME_OR_FOLDER` explores a building with a policy, and prints the figures.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
import tyro
from stable_baselines3.common.policies import BasePolicy

import mecp_env  # noqa: F401  (registers the environments)
from mecp_env.core.errors import ConfigError
from mecp_env.core.exit_codes import ended
from mecp_env.core.settings import guess
from mecp_env.learning import files
from mecp_env.learning.compact import compact
from mecp_env.learning.config import ALGORITHMS, TrainConfig, read_config
from mecp_env.learning.files import WeightError
from mecp_env.learning.foreign import ForeignAgent, load_zip
from mecp_env.learning.models import make_policy, use_threads
from mecp_env.learning.player import Player
from mecp_env.learning.run_folder import CONFIG, POLICY
from mecp_env.policies.registry import WEIGHTS, shipped

FILE_NAME = re.compile(r"[\w.-]{1,100}\.safetensors", re.ASCII)
MOST_BYTES = files.MOST_POLICY_BYTES


class LearnedAgent:
    """A trained policy: takes its most probable action, on nothing but the observation."""

    def __init__(self, policy: BasePolicy, config: TrainConfig, name: str) -> None:
        self.policy, self.config, self.name = policy, config, name
        self.actions = config.actions
        self.reset()

    def reset(self, seed: int = 0) -> None:
        """Begin an episode; nothing here is random."""
        self.player = Player(self.policy, 1)

    def act(self, observation: dict[str, Any], mask: Any = None) -> Any:
        """A row of the goals, or velocities (2,) float32; `mask` (32,) bars rows."""
        many = {name: values[None] for name, values in compact(observation, goals=self.actions == "goal").items()}
        action = self.player.act(many, None if mask is None else np.asarray(mask, np.bool_)[None])[0]
        return int(action) if self.actions == "goal" else np.asarray(action, np.float32)


def load(name_or_folder: str | Path, trust: bool = False) -> LearnedAgent | ForeignAgent:
    """The policy of that name from `mecp_env/learning/weights`, or that of the folder of a run, as an agent.

    With `trust` also the model file of Stable-Baselines3 at that path, which may run any code while it is loaded.
    From then on PyTorch computes in one thread: one observation is too little for more, and the bits stay the same.
    Raises `ConfigError` for a name or a configuration that is wrong, `WeightError` for weights that are damaged, too
    large, not those of their checksum, or of another network.
    """
    path = Path(name_or_folder)
    use_threads(1)
    if path.suffix == ".safetensors":
        raise ConfigError(f"policy: {path} is the weights alone, name the folder that they lie in")
    if path.suffix == ".zip" or path.is_file():
        return load_zip(path, trust)
    folder = WEIGHTS / path if str(path) in ALGORITHMS else path
    if not folder.is_dir():
        near = guess(path, shipped())
        raise ConfigError(f"policy: {path} is none of {', '.join(shipped())}, and no folder of a run{near}")
    config = TrainConfig.build(read_config(folder / CONFIG))
    policy = make_policy(config)
    put_policy(policy, folder, config)
    return LearnedAgent(policy, config, str(path))


def put_policy(policy: BasePolicy, folder: Path, config: TrainConfig) -> None:
    """Give a policy the weights that `policy.json` of a folder names. Raises `WeightError`."""
    if not (folder / POLICY).exists():
        raise WeightError(f"{folder}: holds no policy yet ({POLICY} is missing)")
    about = read_config(folder / POLICY)
    algorithm = about.get("algorithm")
    if algorithm != config.algorithm:
        raise WeightError(f"{folder / POLICY}: weights of {algorithm!r:.80}, {CONFIG} is of {config.algorithm}")
    name, sha256 = about.get("file"), about.get("sha256")
    if not isinstance(name, str) or not isinstance(sha256, str) or not FILE_NAME.fullmatch(name):
        raise WeightError(f"{folder / POLICY}: names no file of this folder with its SHA-256")
    path = folder / name
    files.put_weights(policy, files.tensors_in(files.read_checked(path, sha256, MOST_BYTES), path), path)


@dataclass(frozen=True)
class Args:
    """Explore a building with a trained policy, and print the figures."""

    policy: Annotated[str, tyro.conf.Positional]  # a shipped name, the folder of a run, or with --trust a model file
    trust: bool = False  # load a model file of Stable-Baselines3, which may run any code
    difficulty: str = "medium"
    split: str = "validation"
    building: int = 0


def main(args: Args) -> int:
    """Load, explore, print the figures. Exit code 0, 2 for wrong input, or 130 after Ctrl-C."""
    return ended("learned", lambda: explore(args))


def explore(args: Args) -> int:
    """One episode; prints its figures."""
    agent = load(args.policy, args.trust)
    where = {"difficulty": args.difficulty, "split": args.split, "start": "random"}
    env = gym.make("mecp_env/Rooms-v0", actions=agent.actions, **where)
    observation, _ = env.reset(seed=args.building, options={"building": args.building})
    agent.reset(args.building)
    over = False
    while not over:
        mask = env.get_wrapper_attr("action_masks")() if agent.actions == "goal" else None
        observation, _, terminated, truncated, _ = env.step(agent.act(observation, mask))
        over = terminated or truncated
    for name, value in env.get_wrapper_attr("summary")().items():
        print(f"{name:26s}{value:10.4g}")
    env.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Args)))
