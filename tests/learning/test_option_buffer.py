"""Options in a rollout of Stable-Baselines3: discounts of their own, advantages, and the value after a step limit."""

import numpy as np
import pytest
import torch
from stable_baselines3.common.callbacks import BaseCallback

from mecp_env.learning.encoder import make_model
from mecp_env.learning.environments import make_many
from mecp_env.learning.sb3_batch import OptionBuffer, OptionCallback, bootstrap_truncated
from tests.learning.training import QUICK, quick


class Discounts(BaseCallback):
    """Keeps the discounts that the environments name."""

    def _on_training_start(self):
        self.seen = []

    def _on_step(self):
        self.seen.append([info["discount"] for info in self.locals["infos"]])
        return True


def test_each_option_of_a_rollout_has_the_discount_that_its_environment_names():
    config = quick(
        "maskable_ppo", environments=3, buildings={"layout": "two_rooms"}, env=QUICK["env"] | {"max_steps": 40}
    )
    venv = make_many(config, 0)
    model, kept = make_model(config, venv, 0), Discounts()
    model.learn(model.n_steps * 3, callback=[OptionCallback(), kept])
    np.testing.assert_allclose(model.rollout_buffer.discounts, kept.seen, rtol=1e-6)
    assert len(np.unique(kept.seen)) > 3  # longer drives have smaller ones
    venv.close()


class Sum:
    """A critic that adds up what it sees."""

    def obs_to_tensor(self, observation):
        return torch.as_tensor(observation), False

    def predict_values(self, observation):
        return observation.sum()


def test_the_value_after_a_step_limit_counts_by_the_discount_of_its_option():
    rewards = np.array([1.0, 1.0], np.float32)
    infos = [
        {"TimeLimit.truncated": True, "discount": 0.5, "terminal_observation": np.array([3.0, 1.0])},
        {"TimeLimit.truncated": False, "discount": 0.5},
    ]
    bootstrap_truncated(Sum(), rewards, infos)
    assert rewards.tolist() == [3.0, 1.0]
    assert not infos[0]["TimeLimit.truncated"]  # Stable-Baselines3 would add it again


def test_advantages_of_drives_are_those_of_the_definition():
    """Against the plain sums, over an end of an episode in the middle."""
    config = quick()
    venv = make_many(config, 0)
    rng = np.random.default_rng(0)
    buffer = OptionBuffer(6, venv.observation_space, venv.action_space, "cpu", 0.9, 1.0, n_envs=2)
    venv.close()
    buffer.rewards, buffer.values = (rng.normal(size=(6, 2)).astype(np.float32) for _ in range(2))
    buffer.discounts = rng.uniform(0.5, 1.0, (6, 2)).astype(np.float32)
    buffer.episode_starts[3, 0] = 1.0
    last, dones = rng.normal(size=2).astype(np.float32), np.array([False, True])
    buffer.compute_returns_and_advantage(torch.as_tensor(last), dones)
    for column in range(2):
        for row in range(6):
            expected, weight = 0.0, 1.0
            for k in range(row, 6):
                ends = buffer.episode_starts[k + 1, column] if k < 5 else dones[column]
                ahead = buffer.values[k + 1, column] if k < 5 else last[column]
                onward = buffer.discounts[k, column] * (1.0 - ends)
                expected += weight * (buffer.rewards[k, column] + onward * ahead - buffer.values[k, column])
                weight *= onward * 0.9
            assert buffer.advantages[row, column] == pytest.approx(expected, abs=1e-5)
