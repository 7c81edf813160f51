"""The batch of environments as Stable-Baselines3 wants it: `SB3Batch(make_batch(...))` in place of SubprocVecEnv.

The same environments, seeds and autoreset as SubprocVecEnv; goal masks for MaskablePPO come without asking a worker.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.env_util import is_wrapped
from stable_baselines3.common.vec_env import VecEnv

from mecp_env.vector import BatchEnv, make_batch

MASKS = "action_masks"


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
        self.batch = batch
        super().__init__(batch.num_envs, batch.single_observation_space, batch.single_action_space)

    def reset(self) -> Any:
        """First observations; seeds given by `seed` and options given by `set_options` count once."""
        if any(options != self._options[0] for options in self._options):
            raise ValueError("set_options: a batch takes the same options for all environments")
        observations, infos = self.batch.reset(seed=self._seeds, options=self._options[0] or None)
        self.reset_infos = rows(infos, self.num_envs)
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Have the workers begin a step."""
        self.batch.step_async(actions)

    def step_wait(self) -> Any:
        """Observations, rewards (N,) float32, dones (N,), infos."""
        observations, reward, terminated, truncated, infos = self.batch.step_wait()
        dones = terminated | truncated
        each = rows(infos, self.num_envs)
        for i in np.flatnonzero(dones).tolist():
            last, final = each[i].pop("final_obs"), each[i].pop("final_info")
            self.reset_infos[i], each[i] = each[i], final | {"terminal_observation": last}
        for info, cut in zip(each, (truncated & ~terminated).tolist(), strict=True):
            info["TimeLimit.truncated"] = cut and not info.get("diverged", False)
        return observations, reward.astype(np.float32), dones, each

    def close(self) -> None:
        """Stop the workers; may be called twice."""
        self.batch.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the environments in `indices`, or of all."""
        return self._each(_get, (attr_name,), indices)

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the environments in `indices`, or of all."""
        self._each(_set, (attr_name, value), indices)

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """What a method of the environments in `indices`, or of all, returns."""
        if method_name == MASKS:
            masks = self.batch.action_masks()
            return [masks[i] for i in self._get_indices(indices)]
        return self._each(_call, (method_name, method_args, method_kwargs), indices)

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: Any = None) -> list[bool]:
        """Whether the environments are wrapped in that class."""
        return self._each(is_wrapped, (wrapper_class,), indices)

    def has_attr(self, attr_name: str) -> bool:
        """Whether all environments have an attribute of that name."""
        return all(self._each(_has, (attr_name,), None))

    def _each(self, function: Callable[..., Any], arguments: tuple[Any, ...], indices: Any) -> list[Any]:
        chosen = set(self._get_indices(indices))
        return self.batch.each(function, [arguments if i in chosen else None for i in range(self.num_envs)])

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """A frame of each environment."""
        return self.batch.render() or [None] * self.num_envs


def rows(infos: dict[str, Any], count: int) -> list[dict[str, Any]]:
    """An info for each environment out of a batched one."""
    each: list[dict[str, Any]] = [{} for _ in range(count)]
    masks = {f"_{name}" for name in infos}
    for name in (name for name in infos if name not in masks):
        values = _values(infos[name], count)
        for i in np.flatnonzero(infos[f"_{name}"]).tolist():
            each[i][name] = values[i]
    return each


def _values(column: Any, count: int) -> Any:
    """A column of a batched info as values of single ones."""
    if isinstance(column, dict):
        return rows(column, count)
    return column.tolist() if column.ndim == 1 else column


def _get(env: gym.Env[Any, Any], name: str) -> Any:
    return env.get_wrapper_attr(name)


def _has(env: gym.Env[Any, Any], name: str) -> bool:
    return env.has_wrapper_attr(name)


def _set(env: gym.Env[Any, Any], name: str, value: Any) -> None:
    env.set_wrapper_attr(name, value)


def _call(env: gym.Env[Any, Any], name: str, arguments: tuple[Any, ...], keywords: dict[str, Any]) -> Any:
    return env.get_wrapper_attr(name)(*arguments, **keywords)
