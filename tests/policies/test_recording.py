"""`mecp-env record-dataset`: what Minari reads is what the environment showed, and it can be played again."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mecp_env.cli.main import main
from mecp_env.policies.recording import INFOS, Recording
from tests.env.helpers import same

pytest.importorskip("h5py", reason="needs the extra datasets")
minari = pytest.importorskip("minari", reason="needs the extra datasets")

SHORT = ["--max-steps", "60", "--episodes", "2"]
QUICK = ["--difficulty", "easy", *SHORT]
Captured = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    return tmp_path


def record(*options: str) -> Any:
    quick = SHORT if "--task" in options else QUICK
    assert main(["record-dataset", *options, *quick, "--name", "test/own-v0"]) == 0
    return minari.load_dataset("test/own-v0")


def row_of(observations: Any, step: int) -> Any:
    if isinstance(observations, dict):
        return {name: values[step] for name, values in observations.items()}
    return observations[step]


def assert_plays_again(dataset: Any) -> None:
    """The environment of the dataset shows the same when its actions are repeated."""
    env = dataset.recover_environment()
    assert env.observation_space == dataset.observation_space
    assert env.action_space == dataset.action_space
    for episode, seed in zip(dataset.iterate_episodes(), range(2), strict=True):
        steps = [(env.reset(seed=seed, options={"building": seed})[0], 0.0, False, False)]
        steps += [env.step(action)[:4] for action in episode.actions]
        for step, (observation, *_) in enumerate(steps):
            assert same(dict_or_array(observation), row_of(episode.observations, step))
        ends = [list(column) for column in zip(*[step[1:] for step in steps[1:]], strict=True)]
        assert ends == [episode.rewards.tolist(), episode.terminations.tolist(), episode.truncations.tolist()]
        assert episode.terminations[-1] or episode.truncations[-1]
    env.close()


def dict_or_array(observation: Any) -> Any:
    return dict(sorted(observation.items())) if isinstance(observation, dict) else observation


@pytest.mark.parametrize(
    ("policy", "observation"), [("random_goal", "flat"), ("bfs", "dict"), ("maskable_ppo", "dict")]
)
def test_policies_are_recorded_in_both_formats(policy: str, observation: str) -> None:
    if policy == "maskable_ppo":
        pytest.importorskip("torch", reason="needs the extra rl")
        pytest.importorskip("sb3_contrib", reason="needs the extra rl")
    dataset = record(policy, "--observation", observation)
    assert dataset.total_episodes == 2
    assert dataset.storage.metadata["algorithm_name"] == policy
    assert_plays_again(dataset)
    for episode in dataset.iterate_episodes():
        assert set(episode.infos) == {*INFOS, "action_masks"}
        assert episode.infos["coverage"].shape == (len(episode) + 1,)
        chosen = episode.infos["action_masks"][np.arange(len(episode)), episode.actions]
        assert chosen.all() or not episode.infos["action_masks"].any(axis=1).all()


def test_velocities_are_recorded_in_every_control_step() -> None:
    dataset = record("random_walk")
    assert dataset.action_space.shape == (2,)
    assert_plays_again(dataset)


def test_the_drives_of_a_policy_are_recorded_as_velocities() -> None:
    """Only a drive closes goals, so these may differ when the velocities are repeated; the estimate does not."""
    dataset = record("nearest", "--actions", "velocity")
    env = dataset.recover_environment()
    for seed, episode in enumerate(dataset.iterate_episodes()):
        env.reset(seed=seed, options={"building": seed})
        poses = [env.step(action)[0][:10] for action in episode.actions[:-1]]
        assert same(np.array(poses), episode.observations[1:-1, :10])
        assert episode.infos["period"].tolist() == list(range(len(episode) + 1))
        assert set(episode.infos) == set(INFOS)


def test_a_task_is_recorded_with_its_robot_and_its_uncertainty() -> None:
    dataset = record("returning", "--task", "ActiveHalls-v0")
    assert dataset.observation_space.shape == (421,)
    assert dataset.env_spec.id == "mecp_env/ActiveHalls-v0"


def test_a_dataset_is_never_overwritten(capsys: Captured) -> None:
    record("nearest")
    assert main(["record-dataset", "bfs", *QUICK, "--name", "unversioned"]) == 2
    assert "name: 'unversioned', expected FOLDER/NAME-vNUMBER" in capsys.readouterr().err
    assert main(["record-dataset", "bfs", *QUICK, "--name", "test/own-v0"]) == 2
    assert "choose another name or version, or delete it" in capsys.readouterr().err
    assert minari.load_dataset("test/own-v0").storage.metadata["algorithm_name"] == "nearest"


def test_without_minari_the_extra_is_named(monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    assert main(["record-dataset", "bfs", *QUICK]) == 2
    assert "pip install 'mecp_env[datasets]'" in capsys.readouterr().err


def test_an_interrupted_recording_keeps_the_finished_episodes(
    monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    whole = Recording.episodes

    def interrupted(recording: Recording, first: int, count: int) -> Any:
        yield next(whole(recording, first, count))
        raise KeyboardInterrupt

    monkeypatch.setattr(Recording, "episodes", interrupted)
    assert main(["record-dataset", "nearest", *QUICK, "--name", "test/cut-v0"]) == 130
    assert "test/cut-v0: 1 episodes" in capsys.readouterr().out
    assert minari.load_dataset("test/cut-v0").total_episodes == 1


def test_a_network_clones_a_policy_from_a_dataset(capsys: Captured) -> None:
    pytest.importorskip("torch")
    from agents import behaviour_cloning as cloning

    dataset = record("nearest")
    args = cloning.Args("test/own-v0", epochs=300, episodes=1)
    data = cloning.load(dataset)
    network = cloning.clone(data, args)
    assert cloning.agreement(network, data) > 0.9
    env = dataset.recover_environment(split="validation")
    assert cloning.explore(env, network, 0)["coverage"] > 0.1
    env.close()
