"""Rollouts of groups of environments: while the policy acts for one group, the others drive.

Results do not depend on which group is finished first: each group is a batch of its own for the network, has its own
rows of the buffer, and draws its actions with a seed of its own for each step; rewards are normalised at the end.
"""

from __future__ import annotations

import copy
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.buffers import MaskableDictRolloutBuffer
from stable_baselines3 import PPO
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.utils import obs_as_tensor
from stable_baselines3.common.vec_env import VecNormalize
from torch import Tensor

from mecp_env.learning.sb3_batch import MASKS


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

    def compute_returns_and_advantage(self, last_values: Tensor, dones: np.ndarray) -> None:
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


def bootstrap_truncated(policy: BasePolicy, rewards: np.ndarray, infos: list[dict[str, Any]]) -> None:
    """Add to `rewards` (n_envs,) the value after options that a step limit truncated, by their own discount.

    sb3-contrib would use the constant discount, that of an option without metres.
    """
    for row, info in [(row, info) for row, info in enumerate(infos) if info["TimeLimit.truncated"]]:
        info["TimeLimit.truncated"] = False  # it is added here
        with torch.no_grad():
            value = policy.predict_values(policy.obs_to_tensor(info["terminal_observation"])[0])
        rewards[row] += info["discount"] * float(value)


class GroupedRollouts:
    """A mixin for PPO and MaskablePPO: environments are collected in `groups`; environment i is in group i % groups.

    The environments have `send(actions, envs)` and `recv(groups)`, as of `SB3Batch`, and `discount` in their infos.

    With `overlap` the policy is updated on a rollout while the next one is collected, by the policy from before that
    update. PPO compares with the probabilities of the policy that acted, so that one update between them is allowed.
    """

    groups, overlap = 1, False
    behind = False  # the buffer holds a rollout that the policy has not been updated on
    spare: Any = None  # with `overlap`: another buffer,
    actor: Any = None  # and a policy that acts while the other one is updated

    def collect_rollouts(self, env: Any, callback: Any, rollout_buffer: Any, *_: Any, **__: Any) -> bool:
        """Fill the buffer; False when a callback ended the training."""
        model: Any = self
        model.policy.set_training_mode(False)
        callback.on_rollout_start()
        if not self.behind:
            going = Rollout(model, model.policy, rollout_buffer, env, callback).collect()
        else:
            actor, buffer = self._before_update()
            with ThreadPoolExecutor(1) as learner:
                update = learner.submit(super().train)  # type: ignore[misc]
                going = Rollout(model, actor, buffer, env, callback).collect()
                update.result()
            model.rollout_buffer, self.spare, self.behind = buffer, rollout_buffer, False
        if going:
            callback.on_rollout_end()
        return going

    def train(self) -> None:
        """Update the policy on the rollout, or with `overlap` leave that to the collection of the next one."""
        model: Any = self
        self.behind = self.overlap and model.num_timesteps < model._total_timesteps
        if not self.behind:
            super().train()  # type: ignore[misc]

    def _before_update(self) -> tuple[Any, Any]:
        """A copy of the policy as it is now, and a buffer for what it collects."""
        model: Any = self
        if self.actor is None:
            with torch.random.fork_rng(devices=[]):  # its first weights are drawn, and replaced
                spaces = model.observation_space, model.action_space
                self.actor = model.policy_class(*spaces, model.lr_schedule, **model.policy_kwargs)
            self.actor.set_training_mode(False)
            self.spare = copy.deepcopy(model.rollout_buffer)
        self.actor.load_state_dict(model.policy.state_dict())
        return self.actor, self.spare


class GroupedPPO(GroupedRollouts, PPO):
    """PPO with rollouts of groups."""


class GroupedMaskablePPO(GroupedRollouts, MaskablePPO):
    """MaskablePPO with rollouts of groups."""


class Rollout:
    """One rollout: each environment makes as many decisions as the buffer has rows for it."""

    def __init__(self, model: Any, policy: Any, buffer: Any, env: Any, callback: Any) -> None:
        buffer.reset()
        self.model, self.policy, self.buffer, self.callback = model, policy, buffer, callback
        self.env = env.venv if isinstance(env, VecNormalize) else env
        count = min(model.groups, env.num_envs)
        self.groups = [np.arange(first, env.num_envs, count) for first in range(count)]
        self.observations = [{name: rows[own] for name, rows in model._last_obs.items()} for own in self.groups]
        self.made = [0] * count  # decisions of each group
        self.under_way = 0  # groups
        self.dones = np.zeros((model.n_steps, env.num_envs), np.bool_)
        self.after_limits = np.zeros((model.n_steps, env.num_envs), np.float32)  # discounted values there
        self.seeds = torch.randint(2**63 - 1, (model.n_steps, count)).tolist()

    def collect(self) -> bool:
        """Fill the buffer; False when a callback ended the training, with no environment under way."""
        random_state = torch.get_rng_state()
        try:
            for group in range(len(self.groups)):
                self.act(group)
            going = True
            while self.under_way:
                group = self.receive()
                going = going and self.callback.on_step()
                if going and self.made[group] < self.model.n_steps:
                    self.act(group)
        finally:
            torch.set_rng_state(random_state)
        if going:
            self.finish()
        return going

    def act(self, group: int) -> None:
        """Choose the actions of a group and send them; write the decisions to the buffer."""
        envs, observations, buffer = self.groups[group], self.observations[group], self.buffer
        masks: dict[str, Any] = {}
        if isinstance(buffer, MaskableDictRolloutBuffer):
            masks["action_masks"] = np.stack(self.env.env_method(MASKS, indices=envs))
        torch.default_generator.manual_seed(self.seeds[self.made[group]][group])
        with torch.inference_mode():
            chosen, values, log_probs = self.policy(obs_as_tensor(observations, self.model.device), **masks)
        actions = chosen.cpu().numpy()
        self.env.send(within(self.model.action_space, actions), envs)
        self.under_way += 1
        at = self.made[group], envs
        columns = {"actions": actions.reshape(len(envs), -1), "values": values.flatten(), "log_probs": log_probs}
        for name, rows in (columns | masks).items():
            getattr(buffer, name)[at] = rows
        for name, rows in observations.items():
            buffer.observations[name][at] = rows

    def receive(self) -> int:
        """The next group that has made its decision, whose results are in the buffer then."""
        group: int
        group, (observations, rewards, dones, infos) = self.env.recv(self.groups)
        at = self.made[group], self.groups[group]
        self.made[group] += 1
        self.under_way -= 1
        self.observations[group] = observations
        self.buffer.rewards[at], self.dones[at] = rewards, dones
        if isinstance(self.buffer, OptionBuffer):
            self.buffer.discounts[at] = [info["discount"] for info in infos]
        added = np.zeros(len(dones), np.float32)
        bootstrap_truncated(self.policy, added, infos)
        self.after_limits[at] = added
        self.model.num_timesteps += len(dones)
        self.model._update_info_buffer(infos, dones)
        self.callback.update_locals({"infos": infos, "rewards": rewards, "dones": dones})
        return group

    def finish(self) -> None:
        """Normalise rewards, compute advantages, and let the next rollout continue from here."""
        model, buffer = self.model, self.buffer
        order = np.argsort(np.concatenate(self.groups))
        model._last_obs = {
            name: np.concatenate([part[name] for part in self.observations])[order] for name in self.observations[0]
        }
        buffer.episode_starts[0], buffer.episode_starts[1:] = model._last_episode_starts, self.dones[:-1]
        model._last_episode_starts = self.dones[-1]
        buffer.rewards = normalised(model.env, buffer.rewards, self.dones) + self.after_limits
        buffer.pos, buffer.full = buffer.buffer_size, True
        with torch.no_grad():
            values = self.policy.predict_values(obs_as_tensor(model._last_obs, model.device))
        buffer.compute_returns_and_advantage(values, self.dones[-1])


def within(space: Any, actions: NDArray[Any]) -> NDArray[Any]:
    """Actions within the bounds of their space, if it has some."""
    return np.clip(actions, space.low, space.high) if hasattr(space, "low") else actions


def normalised(env: Any, rewards: NDArray[np.float32], dones: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Rewards (steps, n_envs) as `VecNormalize` would have returned them step by step; it takes note of them."""
    if not isinstance(env, VecNormalize):
        return rewards
    found = np.empty_like(rewards)
    for step in range(len(rewards)):
        env._update_reward(rewards[step])
        found[step] = env.normalize_reward(rewards[step])
        env.returns[dones[step]] = 0.0
    return found
