"""A network of Stable-Baselines3 as a policy."""

from __future__ import annotations

from typing import Any

import numpy as np

from mecp_env.learning.config import TrainConfig
from mecp_env.learning.downsampled import downsample, goal_masks


class PredictingPolicy:
    """Takes the most probable action of a model or network, as a function of the observation alone.

    With a configuration the network receives the downsampled observation, else the environment's own.
    """

    def __init__(self, network: Any, actions: str, config: TrainConfig | None, name: str) -> None:
        self.network, self.actions, self.config, self.name = network, actions, config, name
        self.reset()

    def reset(self, seed: int = 0) -> None:
        """Start an episode; nothing here is random."""
        self.memory: Any = None
        self.episode_start = np.ones(1, np.bool_)

    def act(self, observation: dict[str, Any], mask: Any = None) -> Any:
        """A row of the goals, or velocities (2,) float32; `mask` (32,) excludes rows."""
        goals, masks = self.actions == "goal", dict[str, Any]()
        if goals:
            masks["action_masks"] = np.asarray(goal_masks(observation) if mask is None else mask, np.bool_)[None]
        inputs = observation if self.config is None else downsample(observation, goals)
        batch = {name: np.asarray(values)[None] for name, values in inputs.items()}
        actions, self.memory = self.network.predict(batch, self.memory, self.episode_start, deterministic=True, **masks)
        self.episode_start = np.zeros(1, np.bool_)
        return int(actions[0]) if goals else np.asarray(actions[0], np.float32)
