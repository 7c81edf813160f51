"""Rollouts of groups: what Stable-Baselines3 would have collected with the same draws, whichever group is first."""

from __future__ import annotations

import copy
import shutil

import numpy as np
import pytest

torch = pytest.importorskip("torch")
contrib = pytest.importorskip("sb3_contrib")
sb3 = pytest.importorskip("stable_baselines3")

from stable_baselines3.common.callbacks import BaseCallback  # noqa: E402
from stable_baselines3.common.vec_env import VecNormalize  # noqa: E402

from mecp_env.learning.callbacks import OptionCallback  # noqa: E402
from mecp_env.learning.checkpoints import Checkpoints, read_checkpoint  # noqa: E402
from mecp_env.learning.environments import make_many  # noqa: E402
from mecp_env.learning.models import make_model  # noqa: E402
from tests.learning.training import QUICK, quick, resume, run  # noqa: E402

THEIRS = {"maskable_ppo": contrib.MaskablePPO, "ppo": sb3.PPO}
EXACT = ("actions", "episode_starts", "values", "log_probs")
CLOSE = ("rewards", "advantages", "returns")  # the value after a limit is rounded before it is added, or afterwards
SHORT = {"maskable_ppo": 40, "ppo": 4}  # control steps of an episode: several end at the limit


def model_of(algorithm, callbacks=(), groups=2, count=5):
    """A model with its first observations, and what calls its callbacks."""
    fields = {"buildings": {"layout": "two_rooms"}, "env": QUICK["env"] | {"max_steps": SHORT[algorithm]}}
    config = quick(algorithm, environments=count, groups=groups, **fields)
    venv = VecNormalize(make_many(config, 0), norm_obs=False, gamma=0.9)
    model = make_model(config, venv, 0)
    return model, model._setup_learn(1000, list(callbacks))[1]


def collected(model, callbacks, rollouts=2):
    """The buffer after some rollouts, and what the next one starts from."""
    torch.manual_seed(5)
    for _ in range(rollouts):
        assert model.collect_rollouts(model.env, callbacks, model.rollout_buffer, model.n_steps)
    buffer, rewards = model.rollout_buffer, model.env.ret_rms
    found = {
        name: getattr(buffer, name).copy()
        for name in (*EXACT, *CLOSE, "discounts", "action_masks")
        if hasattr(buffer, name)
    }
    found |= {f"observations/{name}": rows.copy() for name, rows in buffer.observations.items()}
    found |= {f"last/{name}": rows for name, rows in model._last_obs.items()}
    found |= {"starts": model._last_episode_starts, "mean": rewards.mean, "var": rewards.var, "random": torch.rand(3)}
    return found | {"timesteps": model.num_timesteps}


def by_their_code(model, algorithm, groups):
    """Lets the code of Stable-Baselines3 collect, with a policy that acts for one group after another."""
    forward, theirs = model.policy.forward, THEIRS[algorithm].collect_rollouts
    seeds = []

    def act(observations, action_masks=None):
        count = len(observations["pose"])
        own = [torch.arange(first, count, groups) for first in range(groups)]
        rows = []
        for place, seed in zip(own, seeds.pop(0), strict=True):
            torch.default_generator.manual_seed(seed)
            masks = {} if action_masks is None else {"action_masks": action_masks[place.numpy()]}
            rows.append(forward({name: part[place] for name, part in observations.items()}, **masks))
        order = torch.argsort(torch.cat(own))
        return tuple(torch.cat(column)[order] for column in zip(*rows, strict=True))

    def collect(*arguments):
        seeds.extend(torch.randint(2**63 - 1, (model.n_steps, groups)).tolist())
        state = torch.get_rng_state()
        going = theirs(model, *arguments)
        torch.set_rng_state(state)
        return going

    model.policy.forward, model.collect_rollouts = act, collect


@pytest.mark.parametrize("algorithm", THEIRS)
def test_a_rollout_is_what_stable_baselines3_collects_with_the_same_draws(algorithm):
    """Observations, masks, decisions, rewards with the value after a step limit, advantages; also in the next one."""
    (model, none), (other, callbacks) = model_of(algorithm), model_of(algorithm, [OptionCallback()])
    by_their_code(other, algorithm, 2)
    mine, theirs = collected(model, none), collected(other, callbacks)
    assert mine.keys() == theirs.keys()
    assert mine["episode_starts"][1:].any()
    for name in mine:
        if name in CLOSE:
            np.testing.assert_allclose(mine[name], theirs[name], rtol=1e-5, atol=1e-6, err_msg=name)
        else:
            np.testing.assert_array_equal(mine[name], theirs[name], err_msg=name)
    model.env.close()
    other.env.close()


@pytest.mark.parametrize("algorithm", THEIRS)
def test_no_bit_depends_on_which_group_is_finished_first(algorithm):
    found = []
    for seed in (None, 0, 1):
        model, none = model_of(algorithm, groups=3, count=4)
        inner, rng = model.env.unwrapped, np.random.default_rng(seed)
        in_order = inner.recv

        def recv(groups, inner=inner, rng=rng, in_order=in_order):
            inner.sent.rotate(int(rng.integers(len(inner.sent))))
            return in_order(groups)

        if seed is not None:
            inner.recv = recv
        found.append(collected(model, none, rollouts=1))
        model.env.close()
    for name, value in found[0].items():
        assert np.array_equal(value, found[1][name]), name
        assert np.array_equal(value, found[2][name]), name


def test_more_groups_than_environments_are_one_each():
    model, none = model_of("ppo", groups=9, count=2)
    assert collected(model, none, rollouts=1)["timesteps"] == 6 * 2
    model.env.close()


class Stop(BaseCallback):
    """Ends the training in the seventh group."""

    def _on_step(self):
        return self.n_calls < 7


def test_a_training_that_is_stopped_leaves_no_environment_under_way_and_draws_as_before():
    model, callbacks = model_of("maskable_ppo", [Stop()], groups=3)
    torch.manual_seed(5)
    assert not model.collect_rollouts(model.env, callbacks, model.rollout_buffer, model.n_steps)
    assert not model.env.unwrapped.sent
    drawn = torch.rand(3)
    torch.manual_seed(5)
    torch.randint(2**63 - 1, (model.n_steps, 3))
    assert torch.equal(drawn, torch.rand(3))
    model.env.close()


@pytest.mark.slow
def test_two_runs_that_continue_from_a_checkpoint_learn_the_same(tmp_path):
    folder, _ = run(tmp_path, workers="batch", steps=12)
    weights = []
    for name in ("a", "b"):
        shutil.copytree(folder, tmp_path / name)
        assert resume(tmp_path / name, "--steps", "24") == 0
        last = Checkpoints(tmp_path / name / "checkpoints", 3).paths()[-1]
        assert int(last.stem) == 24
        weights.append(read_checkpoint(last)["policy"])
    assert all(torch.equal(weights[0][key], weights[1][key]) for key in weights[0])


def weights_of(model):
    model.env.close()
    return model.policy.state_dict()


def learned(algorithm):
    """The weights after three rollouts with `overlap`."""
    model, _ = model_of(algorithm)
    model.overlap = True
    model.set_random_seed(3)
    model.learn(3 * model.n_steps * model.n_envs)
    assert model._n_updates == 3 * model.n_epochs
    return weights_of(model)


def learned_by_hand(algorithm):
    """The same in one thread: the second rollout by the first policy, each next one by that of the update before."""
    model, none = model_of(algorithm)
    model.set_random_seed(3)
    model._setup_learn(3 * model.n_steps * model.n_envs, [])
    filled = []
    for rollout in range(4):
        if rollout > 1:
            update(model, filled[rollout - 2], rollout - 1)
        if rollout < 3:
            model.rollout_buffer = copy.deepcopy(model.rollout_buffer)
            assert model.collect_rollouts(model.env, none, model.rollout_buffer, model.n_steps)
            filled.append(model.rollout_buffer)
    update(model, filled[2], 3)
    return weights_of(model)


def update(model, buffer, rollouts):
    """One update, as after so many of three rollouts."""
    model.rollout_buffer = buffer
    model._update_current_progress_remaining(rollouts, 3)
    model.train()


@pytest.mark.parametrize("algorithm", THEIRS)
def test_an_update_while_the_next_rollout_is_collected_is_the_one_after_it(algorithm):
    threads, by_hand = learned(algorithm), learned_by_hand(algorithm)
    for name, values in threads.items():
        assert torch.equal(values, by_hand[name]), name


def test_a_failure_of_an_update_beside_a_rollout_ends_the_training(monkeypatch):
    model, _ = model_of("ppo")
    model.overlap = True

    def fail(_):
        raise ZeroDivisionError("in the update")

    monkeypatch.setattr(sb3.PPO, "train", fail)
    with pytest.raises(ZeroDivisionError, match="in the update"):
        model.learn(3 * model.n_steps * model.n_envs)
    model.env.close()
