"""Options in a rollout of Stable-Baselines3: discounts of their own, and the value after a step limit."""

import shutil

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("sb3_contrib")

from stable_baselines3.common.callbacks import BaseCallback  # noqa: E402
from stable_baselines3.common.vec_env import VecNormalize  # noqa: E402

from mecp_env.learning.encoder import make_model  # noqa: E402
from mecp_env.learning.environments import make_many  # noqa: E402
from mecp_env.learning.sb3_batch import OptionCallback, bootstrap_truncated  # noqa: E402
from tests.learning.training import QUICK, checkpoints, quick, resume, run, weights_in  # noqa: E402


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
    venv = VecNormalize(make_many(config, 0), norm_obs=False, gamma=0.9)
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


@pytest.mark.slow
def test_two_runs_that_continue_from_a_checkpoint_learn_the_same(tmp_path):
    folder, _ = run(tmp_path, workers="batch", steps=12)
    weights = []
    for name in ("a", "b"):
        shutil.copytree(folder, tmp_path / name)
        assert resume(tmp_path / name, "--steps", "24") == 0
        last = checkpoints(tmp_path / name)[-1]
        assert int(last.stem) == 24
        weights.append(weights_in(last))
    assert all(torch.equal(weights[0][key], weights[1][key]) for key in weights[0])
