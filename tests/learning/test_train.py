import csv
import json
import signal
import time

import gymnasium as gym
import numpy as np
import pytest
import torch

from mecp_env.config import REWARDS
from mecp_env.episode.potentials import register_reward
from mecp_env.learning.config import ALGORITHMS
from mecp_env.learning.environments import FIGURES, make_env, make_many
from mecp_env.learning.learned import load
from tests.learning.training import QUICK, made_in, quick, run, start, write_config


def rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


SLOW_OTHERS = [pytest.param(name, marks=[pytest.mark.slow] * (name != "maskable_ppo")) for name in ALGORITHMS]


@pytest.mark.parametrize("algorithm", SLOW_OTHERS)
def test_a_run_leaves_all_that_is_needed_and_its_policy_acts(algorithm, tmp_path, capsys):
    folder, code = run(tmp_path, algorithm=algorithm)
    assert code == 0
    assert "+-" not in capsys.readouterr().out  # seen: "+- 0.0000" for one building, as if it were known exactly
    config = quick(algorithm)
    assert json.loads((folder / "config.json").read_text()) == config.to_dict()
    about = json.loads((folder / "run.json").read_text())[0]
    assert about["versions"]["torch"] == torch.__version__
    assert {"command", "commit", "time", "system"} <= about.keys()
    updates, evaluations = rows(folder / "progress.csv"), rows(folder / "evaluation.csv")
    assert [int(float(row["decisions"])) for row in updates] == [12, 24]
    assert all(float(row["periods_per_s"]) > 0 and 0 <= float(row["waiting_share"]) <= 1 for row in updates)
    assert all(float(row[name]) == float(row[name]) for row in evaluations for name in FIGURES)
    policy = load(folder)
    env = gym.make("mecp_env/Rooms-v0", difficulty="easy", actions=policy.actions)
    observation, _ = env.reset(seed=0)
    policy.reset(0)
    for _ in range(2):
        mask = env.get_wrapper_attr("action_masks")() if policy.actions == "goal" else None
        action = policy.act(observation, mask)
        assert mask is None or mask[action]
        observation, *_ = env.step(action)
    before = (folder / "policy.json").read_bytes()
    assert run(tmp_path, algorithm=algorithm)[1] == 2  # a folder that holds a run is not written over
    assert "--resume" in capsys.readouterr().err
    assert (folder / "policy.json").read_bytes() == before


def wait_for_checkpoint(process, folder, beyond=-1):
    """Wait until a run has written a checkpoint after more than this number of decisions."""
    give_up = time.monotonic() + 300
    while process.poll() is None and time.monotonic() < give_up:
        if max(made_in(folder), default=-1) > beyond:
            return
        time.sleep(0.02)
    raise AssertionError(f"no checkpoint: {process.communicate()[0]}")


@pytest.mark.slow
def test_a_killed_run_goes_on_from_its_last_checkpoint(launcher, tmp_path):
    """`kill -9` in the middle of training; the tables have every update once."""
    folder, config = tmp_path / "run", write_config(tmp_path / "given.json", steps=48)
    process = start(launcher, "--config", str(config), "--out", str(folder))
    wait_for_checkpoint(process, folder, beyond=12)
    process.kill()
    process.communicate()
    last = made_in(folder)[-1]
    again = start(launcher, "--resume", str(folder))
    said, _ = again.communicate(timeout=300)
    assert again.returncode == 0, said
    assert f"resumed after {last}" in said
    assert [int(float(row["decisions"])) for row in rows(folder / "progress.csv")] == list(range(12, 49, 12))
    assert [event["event"] for event in json.loads((folder / "run.json").read_text())] == ["begun", "resumed"]
    assert load(folder)


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_ctrl_c_and_sigterm_save_and_say_where(number, launcher, tmp_path):
    folder, config = tmp_path / "run", write_config(tmp_path / "given.json", steps=10_000)
    process = start(launcher, "--config", str(config), "--out", str(folder))
    wait_for_checkpoint(process, folder)
    process.send_signal(number)
    said, _ = process.communicate(timeout=300)
    assert process.returncode == 130, said
    assert f"--resume {folder}" in said.replace("\n", "")
    assert made_in(folder)


def test_what_lies_further_on_counts_less_and_the_discount_is_that_of_the_metres():
    env = make_env(quick(ppo={"discount_m": 5.0}))
    env.reset(seed=0)
    before = env.unwrapped.summary()["metres"]
    _, reward, _, _, info = env.step(0)
    metres = env.unwrapped.summary()["metres"] - before
    assert info["discount"] == pytest.approx(np.exp(-metres / 5.0))
    plain = make_env(quick(ppo={"discount_m": 1e6}))
    plain.reset(seed=0)
    _, undiscounted, *_ = plain.step(0)
    assert reward != undiscounted


def test_custom_rewards_are_part_of_the_return_and_have_a_column(monkeypatch):
    monkeypatch.setattr(REWARDS, "others", [])
    register_reward("landmarks_seen", lambda inputs: float(len(inputs.belief.ids)))
    env = make_env(quick("ppo", env=QUICK["env"] | {"max_steps": 5, "reward": {"custom": {"landmarks_seen": 2.0}}}))
    env.reset(seed=0)
    begin = env.unwrapped.slam_output.belief.ids.size
    steps = [env.step(np.array([0.5, 0.3], np.float32)) for _ in range(5)]
    figures = steps[-1][4]["figures"]
    assert figures["reward_custom"] == 2.0 * (env.unwrapped.slam_output.belief.ids.size - begin)
    assert figures["reward"] == pytest.approx(sum(step[1] for step in steps))


def test_a_divergence_is_an_end_for_the_learner_and_a_time_limit_is_none():
    """With the value of the next state added, divergence was worth as much as keeping the map."""
    for fields, terminal in (({"slam": {"filter": {"diverged_sigma_m": 0.0012}}}, True), ({"max_steps": 2}, False)):
        venv = make_many(quick(env=QUICK["env"] | {"reward": "terms"} | fields), 0)
        venv.reset()
        dones = np.zeros(2, np.bool_)
        while not dones.any():
            _, _, dones, infos = venv.step(np.array([0, 0]))
        info = infos[int(np.flatnonzero(dones)[0])]
        assert info["TimeLimit.truncated"] is not terminal
        assert info["figures"]["terminated"] == 0.0
        assert (info["figures"]["reward_divergence"] < 0.0) is terminal
        venv.close()


def test_weights_that_are_no_numbers_are_neither_kept_nor_loaded(tmp_path, capsys, monkeypatch):
    def ruin(self):
        with torch.no_grad():
            next(self.policy.parameters()).fill_(float("nan"))

    monkeypatch.setattr("sb3_contrib.MaskablePPO.train", ruin)
    folder, code = run(tmp_path)
    assert code == 1
    assert "is not finite any more" in capsys.readouterr().err
    assert made_in(folder) == [0]
    assert load(folder)
