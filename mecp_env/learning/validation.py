"""How good a policy is in the buildings of the validation split, which it does not learn in."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.vec_env import VecEnv

from mecp_env.learning.config import TrainConfig
from mecp_env.learning.environments import FIGURES, gather, make_visits
from mecp_env.learning.player import Player

MOST_WORKERS = 8


class Validation:
    """The environments of an evaluation; they are made when they are first needed."""

    def __init__(self, config: TrainConfig) -> None:
        self.config = config
        self.buildings = config.log.evaluate_buildings
        self.workers = min(self.buildings, MOST_WORKERS, config.environments)
        self.venv: VecEnv | None = None

    def run(self, policy: BasePolicy) -> dict[str, float]:
        """The mean of each figure over the buildings, one episode in each, and their number `n`.

        The policy takes its most probable action; building and seed of each episode are always the same.
        """
        venv = self._begun()
        player, found = Player(policy, self.workers), list[dict[str, float]]()
        left = np.array([len(range(i, self.buildings, self.workers)) for i in range(self.workers)])
        observations = venv.reset()
        assert isinstance(observations, dict)
        while left.any():
            observations, _, dones, infos = venv.step(player.act(observations))
            player.over(dones)
            for i in np.flatnonzero(dones & (left > 0)):
                found.append(infos[i]["figures"])
                left[i] -= 1
        return mean_of(found)

    def close(self) -> None:
        """End the workers."""
        if self.venv is not None:
            self.venv.close()
        self.venv = None

    def _begun(self) -> VecEnv:
        if self.venv is None:
            shares = [range(i, self.buildings, self.workers) for i in range(self.workers)]
            makers = [partial(make_visits, self.config, i, share) for i, share in enumerate(shares)]
            self.venv = gather(makers, self.config.workers)
        elif self.config.buildings.layout is None:
            self.venv.env_method("rewind")
        if self.config.buildings.layout is not None:
            self.venv.seed(0)
        return self.venv


def mean_of(episodes: list[dict[str, float]]) -> dict[str, float]:
    """The means of the figures of some episodes, the standard error of the area under the curve, and `n`."""
    means: dict[str, Any] = {name: float(np.mean([episode[name] for episode in episodes])) for name in FIGURES}
    spread = float(np.std([episode["auc"] for episode in episodes])) / max(1, len(episodes) - 1) ** 0.5
    return means | {"auc_error": spread, "n": len(episodes)}
