"""Models of Stable-Baselines3 of every observation format and action space are scored as they were trained."""

import importlib
import json
import re
import sys
import zipfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import sb3_contrib as contrib
import stable_baselines3 as stock
import torch
from gymnasium import spaces
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecNormalize

from mecp_env.core.errors import ConfigError
from mecp_env.learning.config import WeightError
from mecp_env.learning.exported import class_of
from mecp_env.learning.fits import fit, space_of
from mecp_env.learning.learned import load
from mecp_env.policies.registry import policy_checksum, source_of
from mecp_env.policies.rollout import EpisodeTask, options_of, run_episode
from mecp_env.policies.setting import Setting

EASY = Setting("easy", "validation", "slam", 20)
HALLS = Setting("", "validation", "slam", 12, "ActiveHalls-v0")
NETS = {"flat": "Mlp", "image": "Cnn", "dict": "MultiInput"}
ALGORITHMS = {"PPO": stock.PPO, "MaskablePPO": contrib.MaskablePPO, "RecurrentPPO": contrib.RecurrentPPO}
QUICK = [("PPO", "flat", "goal"), ("MaskablePPO", "image", "goal"), ("RecurrentPPO", "dict", "velocity")]
OTHERS = [("PPO", "image", "discrete"), ("PPO", "dict", "velocity"), ("MaskablePPO", "flat", "discrete")]
OTHERS += [("MaskablePPO", "dict", "goal"), ("RecurrentPPO", "flat", "goal"), ("RecurrentPPO", "image", "discrete")]


def saved(algorithm: str, env: Any, path: Path, net: str) -> str:
    """The file of an untrained small model of an environment."""
    features = {"MultiInput": {"cnn_output_dim": 4}, "Cnn": {"features_dim": 4}, "Mlp": {}}[net]
    lstm = {"lstm_hidden_size": 4} if algorithm == "RecurrentPPO" else {}
    keywords = {"net_arch": [4], "features_extractor_kwargs": features, **lstm}
    policy = f"{net}{'Lstm' if lstm else ''}Policy"
    ALGORITHMS[algorithm](policy, env, n_steps=2, batch_size=2, device="cpu", policy_kwargs=keywords).save(path)
    return str(path)


def model_of(case: tuple[str, str, str], path: Path, env_id: str = "mecp_env/Rooms-v0", **fields: Any) -> str:
    """The file of a model that was trained on a format with some actions."""
    algorithm, form, actions = case
    observation = {"format": form} | fields.pop("observation", {})
    env = gymnasium.make(env_id, actions=actions, observation=observation, **fields)
    return saved(algorithm, env, path, NETS[form])


@pytest.mark.parametrize("case", [*QUICK, *(pytest.param(case, marks=pytest.mark.slow) for case in OTHERS)])
def test_a_model_of_every_format_and_action_space_is_scored(case: tuple[str, str, str], tmp_path: Path) -> None:
    model = model_of(case, tmp_path / "model.zip")
    policy = load(model, trust=True)
    asked = options_of(policy)
    assert (policy.actions, asked["actions"]) == (case[2], case[2])
    assert asked["observation"].get("format", "dict") == case[1]
    figures = run_episode(EpisodeTask(model, 0, EASY, trust=True)).figures
    assert figures["periods"] >= EASY.max_steps or figures["terminated"]
    assert np.isfinite(figures["log_det_mean"])


@pytest.mark.parametrize("uncertainty", [False, True])
def test_the_columns_of_a_flat_model_decide_what_a_task_shows_it(uncertainty: bool, tmp_path: Path) -> None:
    fields = {"observation": {"uncertainty": uncertainty}}
    model = model_of(("MaskablePPO", "flat", "goal"), tmp_path / "model.zip", "mecp_env/ActiveHalls-v0", **fields)
    assert load(model, trust=True).settings["observation"]["uncertainty"] == uncertainty
    assert run_episode(EpisodeTask(model, 0, HALLS, trust=True)).figures["decisions"] > 0


def test_tables_of_rooms_are_what_a_model_of_velocities_sees_in_a_task(tmp_path: Path) -> None:
    """A task adds columns of goals and `localisation`, which the model does not know."""
    model = model_of(("PPO", "dict", "velocity"), tmp_path / "model.zip")
    assert run_episode(EpisodeTask(model, 0, HALLS, trust=True)).figures["decisions"] == HALLS.max_steps


def test_the_order_of_flat_goals_is_that_of_the_training(tmp_path: Path) -> None:
    """Below goal actions the rows of a flat observation are in the order of the goals, not nearest first."""
    policy = load(model_of(("PPO", "flat", "goal"), tmp_path / "model.zip"), trust=True)
    mine = gymnasium.make("mecp_env/Rooms-v0", difficulty="easy", **options_of(policy))
    theirs = gymnasium.make("mecp_env/Rooms-v0", difficulty="easy", actions="goal", observation="flat")
    assert mine.unwrapped.config.actions == "goal"  # type: ignore[attr-defined]
    np.testing.assert_array_equal(mine.reset(seed=3)[0], theirs.reset(seed=3)[0])


def test_statistics_of_normalisation_beside_a_model_are_used(tmp_path: Path) -> None:
    make = lambda: gymnasium.make("mecp_env/Rooms-v0", actions="discrete", observation="flat")  # noqa: E731
    env = VecNormalize(DummyVecEnv([make]), clip_obs=2.0)
    env.obs_rms.mean[:] = 5.0
    model = saved("PPO", env, tmp_path / "model.zip", "Mlp")
    plain = load(model, trust=True)
    env.save(str(tmp_path / "model_vecnormalize.pkl"))
    policy = load(model, trust=True)
    seen: list[Any] = []
    policy.model.algorithm.predict = lambda batch, *args, **kwargs: (seen.append(batch), ([0], None))[1]  # type: ignore[union-attr]
    observation = make().reset(seed=0)[0]
    assert policy.act(observation) == 0
    np.testing.assert_allclose(
        seen[0][0], np.clip((observation - 5.0) / np.sqrt(1.0 + env.epsilon), -2.0, 2.0), rtol=1e-4
    )
    np.testing.assert_array_equal(plain.model.prepare(observation)[0], observation)  # type: ignore[union-attr]
    (tmp_path / "model_vecnormalize.pkl").write_bytes(b"no pickle")
    with pytest.raises(WeightError, match=r"model_vecnormalize\.pkl: cannot be loaded"):
        load(model, trust=True)


@pytest.mark.parametrize("kind", ["PPO", "DQN"])
def test_a_model_of_vec_normalize_without_its_statistics_is_refused(kind: str, tmp_path: Path) -> None:
    sizes = {"n_steps": 2, "batch_size": 2} if kind == "PPO" else {"buffer_size": 20, "learning_starts": 5}
    plain = DummyVecEnv([lambda: gymnasium.make("mecp_env/First-v0", max_steps=9)])
    changed = VecNormalize(plain)
    for env in (plain, VecNormalize(plain, norm_obs=False), changed):  # the second one changes rewards alone
        getattr(stock, kind)("MlpPolicy", env, device="cpu", **sizes).learn(8).save(tmp_path / "model.zip")
        if env is not changed:
            assert load(tmp_path / "model.zip", trust=True).actions == "discrete"
    with pytest.raises(ConfigError, match=r"VecNormalize made, .* beside it as model_vecnormalize\.pkl"):
        load(tmp_path / "model.zip", trust=True)
    changed.save(str(tmp_path / "model_vecnormalize.pkl"))
    assert load(tmp_path / "model.zip", trust=True).actions == "discrete"


def test_a_class_in_a_module_of_the_working_directory_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stable-Baselines3 saves where a class of the user is, not the class."""
    (tmp_path / "my_network.py").write_text(
        "from stable_baselines3.common.policies import ActorCriticPolicy\nclass Mine(ActorCriticPolicy): pass\n"
    )
    env = gymnasium.make("mecp_env/First-v0")
    with monkeypatch.context() as inside:
        inside.syspath_prepend(tmp_path)
        mine = importlib.import_module("my_network").Mine
        stock.PPO(mine, env, n_steps=2, batch_size=2, device="cpu").save(tmp_path / "model.zip")
    monkeypatch.delitem(sys.modules, "my_network")
    monkeypatch.setattr(sys, "path", [place for place in sys.path if place not in ("", str(tmp_path))])
    monkeypatch.chdir(tmp_path)
    assert load("model.zip", trust=True).actions == "discrete"


def test_the_classes_of_the_page_score_weights_and_stacked_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (Path(__file__).parents[2] / "docs/submissions.md").read_text()
    for text, name in re.findall(r'```python\n("""(\w+)\.py""".*?)```', page, re.DOTALL):
        (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.chdir(tmp_path)
    network = torch.nn.Sequential(torch.nn.Linear(325, 64), torch.nn.Tanh(), torch.nn.Linear(64, 32))
    torch.save(network.state_dict(), "agent.pt")
    stacked = VecFrameStack(DummyVecEnv([lambda: gymnasium.make("mecp_env/First-v0")]), 4)
    saved("PPO", stacked, tmp_path / "model.zip", "Mlp")
    for name in ("agent.py:Agent", "frames.py:Frames"):
        assert run_episode(EpisodeTask(source_of(name), 0, EASY, source=source_of(name))).figures["decisions"] > 0
    before = policy_checksum("agent:Agent")
    (tmp_path / "agent.pt").write_bytes(b"")
    assert policy_checksum("agent:Agent") != before
    with pytest.raises(ConfigError, match="class that loads them"):
        load(tmp_path / "agent.pt", trust=True)


@pytest.mark.slow
@pytest.mark.parametrize(("algorithm", "actions"), [("A2C", "goal"), ("DQN", "discrete"), ("SAC", "velocity")])
def test_other_algorithms_of_stable_baselines_are_told_apart(algorithm: str, actions: str, tmp_path: Path) -> None:
    env = gymnasium.make("mecp_env/Rooms-v0", actions=actions, observation="flat")
    memory = {} if algorithm == "A2C" else {"buffer_size": 10}
    model = getattr(stock, algorithm)("MlpPolicy", env, device="cpu", **memory)
    model.save(tmp_path / "model.zip")
    policy = load(tmp_path / "model.zip", trust=True)
    assert type(policy.model.algorithm) is type(model)  # type: ignore[union-attr]
    assert env.action_space.contains(np.asarray(policy.act(env.reset(seed=0)[0]), env.action_space.dtype))


def test_the_settings_in_a_zip_tell_the_algorithm_of_a_custom_policy_class(tmp_path: Path) -> None:
    for setting, algorithm in (
        ("delta_std_schedule", "ARS"),
        ("policy_delay", "CrossQ"),
        ("exploration_fraction", "DQN"),
        ("clip_range", "PPO"),
    ):
        with zipfile.ZipFile(tmp_path / "model.zip", "w") as archive:
            archive.writestr("data", json.dumps({"policy_class": {"__module__": "my_net"}, setting: 0}))
        assert class_of(tmp_path / "model.zip").endswith(f":{algorithm}")


def test_weights_that_are_not_finite_are_no_score(tmp_path: Path) -> None:
    env = gymnasium.make("mecp_env/Rooms-v0", actions="discrete", observation="flat")
    model = stock.DQN("MlpPolicy", env, device="cpu", buffer_size=10, policy_kwargs={"net_arch": [4]})
    next(model.policy.parameters()).data.fill_(np.nan)
    model.save(tmp_path / "model.zip")
    with pytest.raises(WeightError, match="not finite"):
        load(tmp_path / "model.zip", trust=True)


ARRAY = spaces.Box(-1, 1, (104,))


@pytest.mark.parametrize(
    ("observations", "actions", "message"),
    [
        (spaces.Box(-1, 1, (4, 181)), spaces.Discrete(5), r"\(4, 181\).*'uncertainty': False.*stacking frames"),
        (spaces.Box(-np.inf, np.inf, (181,)), spaces.Discrete(5), r"\(-inf, inf, \(181,\).*have Box\(-1, 1"),
        (spaces.Dict(pose=spaces.Box(0, 1, (4,))), spaces.Discrete(5), r"\(pose Box\(0, .*pose Box\(-.*what wrappers"),
        (spaces.Box(0, 255, (12, 64, 64), np.uint8), spaces.Discrete(5), r"\(12, 64, 64\).*\(3, 64, 64\).*'image'"),
        (spaces.Discrete(4), spaces.Discrete(5), r"Discrete\(4\); environments have"),
        (ARRAY, spaces.Box(-2, 2, (3,)), r"Box\(-2.*with actions='velocity'"),
    ],
)
def test_spaces_of_no_environment_name_both_sides(observations: Any, actions: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=f"policy: mine was trained .*{message}"):
        fit(observations, actions, "mine")


def test_images_with_channels_last_and_parts_of_a_dict_fit() -> None:
    last = fit(spaces.Box(0, 255, (64, 64, 3), np.uint8), spaces.Discrete(5), "mine")
    assert (last.format, last.channels_last) == ("image", True)
    parts = space_of("discrete", map=True)
    some = fit(spaces.Dict({name: parts[name] for name in ("pose", "map")}), spaces.Discrete(5), "mine")  # type: ignore[index]
    assert some.settings == {"observation": {"map": True}}


def test_a_model_draws_its_actions_where_the_file_beside_it_says_so(tmp_path: Path) -> None:
    """Seen: DQN drew from generators that nothing had seeded, so that an episode had another score each time."""
    env = gymnasium.make("mecp_env/First-v0")
    observation, _ = env.reset(seed=0)
    dqn = stock.DQN("MlpPolicy", env, device="cpu", buffer_size=10, policy_kwargs={"net_arch": [4]})
    dqn.exploration_rate = 0.9  # as early in a training
    dqn.save(tmp_path / "dqn.zip")
    for path in (Path(model_of(("PPO", "flat", "discrete"), tmp_path / "ppo.zip")), tmp_path / "dqn.zip"):
        assert len(set(choices(path, observation))) == 1
        fields = {"deterministic": False, "planning": {"known_ground": {"places": 1}}}
        path.with_suffix(".json").write_text(json.dumps(fields))
        drawn = choices(path, observation)
        assert len(set(drawn)) > 2
        assert drawn == choices(path, observation)  # from the seed of the episode
        assert load(path, trust=True).settings["planning"] == fields["planning"]
    path.with_suffix(".json").write_text('{"determinstic": false}')
    with pytest.raises(ConfigError, match="did you mean 'deterministic'"):
        load(path, trust=True)


def choices(path: Path, observation: Any) -> list[int]:
    """What a model does in the same place, many times."""
    policy = load(path, trust=True)
    policy.reset(3)
    return [int(policy.act(observation)) for _ in range(30)]
