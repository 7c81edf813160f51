"""The batch of environments as Stable-Baselines3 wants it: `SB3Batch(make_batch(...))` in place of SubprocVecEnv.

The same environments, seeds and autoreset as SubprocVecEnv; goal masks for MaskablePPO come without asking a worker.

Options (the drive to a goal) of different durations in a rollout: each has a discount of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from operator import methodcaller
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import DictInfoToList
from numpy.typing import NDArray

from mecp_env.policies.registry import INSTALL
from mecp_env.vector import BatchEnv, make_batch
from mecp_env.vector.batch import call

try:
    import torch
    from sb3_contrib.common.maskable.buffers import MaskableDictRolloutBuffer
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.env_util import is_wrapped
    from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
    from stable_baselines3.common.policies import BasePolicy
    from stable_baselines3.common.vec_env import VecEnv
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(f"SB3Batch needs {error.name}; {INSTALL}", name=error.name) from None

MASKS = "action_masks"


class OptionBuffer(MaskableDictRolloutBuffer):
    """Advantages of options (macro-actions) of different durations: each is followed by its own discount.

    GAE (Schulman et al. 2016) with gamma replaced by the discount of the option; set `next_discounts` before `add`.
    """

    discounts: np.ndarray
    next_discounts: np.ndarray  # (n_envs,) of the options that are added next

    def reset(self) -> None:
        self.discounts = np.ones((self.buffer_size, self.n_envs), np.float32)
        self.next_discounts = np.full(self.n_envs, self.gamma, np.float32)
        super().reset()

    def add(self, *args: Any, **kwargs: Any) -> None:
        """As of the base class."""
        self.discounts[self.pos] = self.next_discounts
        super().add(*args, **kwargs)

    def compute_returns_and_advantage(self, last_values: torch.Tensor, dones: np.ndarray) -> None:
        """Write `advantages` and `returns` (steps, n_envs)."""
        values = np.concatenate([self.values, last_values.cpu().numpy().reshape(1, -1)])
        ended = np.concatenate([self.episode_starts[1:], dones.astype(np.float32).reshape(1, -1)])
        discounts = self.discounts * (1.0 - ended)
        advantage = np.zeros(self.n_envs, np.float32)
        for step in reversed(range(self.buffer_size)):
            error = self.rewards[step] + discounts[step] * values[step + 1] - values[step]
            advantage = error + discounts[step] * self.gae_lambda * advantage
            self.advantages[step] = advantage
        self.returns = self.advantages + self.values


class OptionCallback(BaseCallback):
    """Passes the discount of every option to the `OptionBuffer`, and adds the value after a step limit."""

    model: OnPolicyAlgorithm

    def _on_step(self) -> bool:
        infos, rewards = self.locals["infos"], self.locals["rewards"]
        if isinstance(self.model.rollout_buffer, OptionBuffer):
            self.model.rollout_buffer.next_discounts = np.array([info["discount"] for info in infos], np.float32)
            bootstrap_truncated(self.model.policy, rewards, infos)
        return True


def bootstrap_truncated(policy: BasePolicy, rewards: np.ndarray, infos: list[dict[str, Any]]) -> None:
    """Add to `rewards` (n_envs,) the value after options that a step limit truncated, by their own discount.

    sb3-contrib would use the constant discount, that of an option without metres.
    """
    for row, info in [(row, info) for row, info in enumerate(infos) if info["TimeLimit.truncated"]]:
        info["TimeLimit.truncated"] = False  # it is added here
        with torch.no_grad():
            value = policy.predict_values(policy.obs_to_tensor(info["terminal_observation"])[0])
        rewards[row] += info["discount"] * float(value)


def make(name: str, num_envs: int, **options: Any) -> SB3Batch:
    """`num_envs` environments of the id `name` as a VecEnv; options as of `mecp_env.vector.make_batch`."""
    return SB3Batch(make_batch(name, num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **options))


class SB3Batch(VecEnv):
    """A `BatchEnv` with `autoreset_mode="SameStep"` as a VecEnv. Raises `ValueError` for another mode.

    `infos` are plain dicts with `TimeLimit.truncated`, and `terminal_observation` where an episode ended, as
    Stable-Baselines3 reads them. A learner adds the value of going on to an episode that was truncated; so one whose
    filter diverged, after which nothing can be earned, is an end here, though the environment truncates it.
    """

    def __init__(self, batch: BatchEnv) -> None:
        if batch.metadata["autoreset_mode"] != AutoresetMode.SAME_STEP or not batch.copy:
            raise ValueError('Stable-Baselines3 wants a batch with autoreset_mode="SameStep" and copy=True')
        self.batch, self._listed = batch, DictInfoToList(batch)
        super().__init__(batch.num_envs, batch.single_observation_space, batch.single_action_space)
        self.metadata = batch.metadata  # of which films take the frame rate

    def reset(self) -> Any:
        """First observations; seeds given by `seed` and options given by `set_options` count once."""
        if any(options != self._options[0] for options in self._options):
            raise ValueError("set_options: a batch takes the same options for all environments")
        seeds: Any = self._seeds
        observations, infos = self._listed.reset(seed=seeds, options=self._options[0] or None)
        self.reset_infos = [_plain(info) for info in infos]
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Observations, rewards (N,) float32, dones (N,), infos."""
        observations, reward, terminated, truncated, listed = self._listed.step(self._actions)
        dones, infos = terminated | truncated, [_plain(info) for info in listed]
        for env in np.flatnonzero(dones).tolist():
            last, final = infos[env].pop("final_obs"), _plain(infos[env].pop("final_info"))
            self.reset_infos[env], infos[env] = infos[env], final | {"terminal_observation": last}
        for info, cut in zip(infos, truncated & ~terminated, strict=True):
            info["TimeLimit.truncated"] = bool(cut) and not info.get("diverged", False)
        return observations, reward.astype(np.float32), dones, infos

    def close(self) -> None:
        """Stop the workers; may be called twice."""
        self.batch.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the environments in `indices`, or of all."""
        return self._each(methodcaller("get_wrapper_attr", attr_name), indices)

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the environments in `indices`, or of all."""
        self._each(methodcaller("set_wrapper_attr", attr_name, value), indices)

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """What a method of the environments in `indices`, or of all, returns."""
        if method_name == MASKS:
            return list(self.batch.action_masks(np.array(self._get_indices(indices))))
        return self._each(partial(call, name=method_name, arguments=method_args, keywords=method_kwargs), indices)

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: Any = None) -> list[bool]:
        """Whether the environments are wrapped in that class."""
        return self._each(partial(is_wrapped, wrapper_class=wrapper_class), indices)

    def has_attr(self, attr_name: str) -> bool:
        """Whether all environments have an attribute of that name."""
        return all(self._each(methodcaller("has_wrapper_attr", attr_name), None))

    def _each(self, function: Callable[..., Any], indices: Any) -> list[Any]:
        chosen = set(self._get_indices(indices))
        return self.batch.each(function, [() if i in chosen else None for i in range(self.num_envs)])

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """A frame of each environment."""
        return self.batch.render() or [None] * self.num_envs


def _plain(info: dict[str, Any]) -> dict[str, Any]:
    """`info` with Python's numbers in place of NumPy's."""
    return {name: value.item() if isinstance(value, np.generic) else value for name, value in info.items()}
