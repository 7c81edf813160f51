"""`First-v0`: small buildings, five motions, a vector; a stock learner trains on it with one command."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from mecp_env.policies.rollout import EpisodeTask, run_episode
from mecp_env.policies.setting import Setting

ROOT = Path(__file__).parents[2]


def test_it_is_small_and_flat_and_can_be_overridden() -> None:
    env = gymnasium.make("mecp_env/First-v0")
    config = env.get_wrapper_attr("config")
    assert (config.max_steps, config.actions, config.reward.preset) == (500, "discrete", "coverage")
    assert isinstance(env.observation_space, spaces.Box)
    assert env.action_space == spaces.Discrete(5)
    assert config.layout["generate"]["difficulty"] == "easy"
    other = gymnasium.make("mecp_env/First-v0", max_steps=40, observation="dict", rooms=3)
    assert other.get_wrapper_attr("config").max_steps == 40
    assert isinstance(other.observation_space, spaces.Dict)


@pytest.mark.slow
def test_a_random_robot_leaves_much_to_learn_and_the_nearest_goal_sees_all() -> None:
    env = gymnasium.make("mecp_env/First-v0", split="validation")
    rng, ends = np.random.default_rng(0), []
    for building in range(6):
        env.reset(seed=building, options={"building": building})
        over = False
        while not over:
            *_, terminated, truncated, info = env.step(int(rng.integers(5)))
            over = terminated or truncated
        ends.append(info["coverage"])
    assert np.mean(ends) < 0.7
    setting = Setting("easy", "validation", "slam", 500)
    nearest = [run_episode(EpisodeTask("nearest", building, setting)).figures["coverage"] for building in range(3)]
    assert min(nearest) > 0.97


@pytest.mark.slow
def test_the_script_writes_model_and_curve(tmp_path: Path) -> None:
    pytest.importorskip("sb3_contrib", reason="needs the extra rl")
    for algorithm, steps in (("ppo", "2000"), ("maskable_ppo", "500")):
        out = tmp_path / algorithm
        line = [sys.executable, "agents/train_first.py", "--algorithm", algorithm, "--steps", steps, "--buildings", "1"]
        subprocess.run([*line, "--environments", "2", "--out", str(out)], cwd=ROOT, check=True, capture_output=True)
        with (out / "seed-0" / "progress.csv").open() as file:
            rows = list(csv.DictReader(file))
        assert int(rows[0]["steps"]) == 0
        assert int(rows[-1]["steps"]) >= int(steps)
        assert 0.0 < float(rows[-1]["coverage"]) <= 1.0
        assert (out / "seed-0" / "model.zip").stat().st_size > 10_000
        assert (out / "curve.png").stat().st_size > 10_000
