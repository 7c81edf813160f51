"""The same environment with the estimator, known correspondences, the true pose, and the literal paper."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from mecp_env.config import EnvConfig
from tests.env.helpers import drive, episode_of, make
from tests.env.test_goal_actions import explore


def test_the_true_pose_is_the_pose():
    env = make(estimator="truth", laser={"preset": "paper"})
    env.reset(seed=1)
    for row in drive(env, 30):
        info = row[-1]
        assert info["pose_error_m"] < 1e-6
        assert info["heading_error_rad"] < 1e-6


def test_true_identities_make_no_wrong_pair():
    env = make(estimator="known", laser={"preset": "paper", "sweeps": 4}, actions="goal")
    explore(env)
    summary = env.unwrapped.summary()
    assert summary["association_false"] == 0
    assert summary["association_recall"] > 0.98  # a corner that is off by more than its noise is left out
    assert summary["duplicates"] == 0


def test_the_paper_runs_to_the_letter():
    env = gymnasium.make("mecp_env/Layout-v0", config=EnvConfig.paper(layout="two_rooms"), actions="goal")
    rows = explore(env)
    assert rows[-1][2] or rows[-1][3]
    assert env.unwrapped.summary()["rooms_found"] >= 1


def test_a_filter_that_diverged_cuts_the_episode_short():
    env = make()
    env.reset(seed=1)
    episode_of(env).pipeline.divergence.found = True
    observation, reward, terminated, truncated, info = env.step(np.zeros(2, np.float32))
    assert (terminated, truncated, info["diverged"]) == (False, True, True)
    assert observation in env.observation_space
    assert np.isfinite(reward)


@pytest.mark.parametrize("layout", ["office", "twins", "furnished"])
def test_every_layout_can_be_walked(layout):
    env = make(layout=layout, start="random", laser={"preset": "paper", "sweeps": 4})
    env.reset(seed=2)
    for row in drive(env, 25):
        assert row[0] in env.observation_space
