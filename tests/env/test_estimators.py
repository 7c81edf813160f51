"""The same environment with the estimator, known correspondences, the true pose, and the literal paper."""

from __future__ import annotations

import gymnasium

from mecp_env.config import EnvConfig
from tests.env.helpers import make
from tests.env.test_goal_actions import explore


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
