"""The contracts of Gymnasium and Stable-Baselines3, over every registered id and kind of action."""

from __future__ import annotations

import copy
import json
import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode

import mecp_env
from mecp_env.config import EnvConfig
from mecp_env.core.errors import ConfigError
from mecp_env.world.layout import load_layout
from mecp_env.wrappers import GoalActions
from tests.env.helpers import IDS, NEEDED, SMALL, make

ACTIONS = ("velocity", "discrete", "goal")
FORMATS = ("dict", "flat", "image")
# Stable-Baselines3 wants images and flat vectors; tables of landmarks and goals are neither, and its flattening
# extractor takes them as they are.
SB3_ALLOWED = ("Your observation landmarks has an unconventional", "Your observation goals has an unconventional")
# The goal actions are a wrapper by design; the check would leave it out.
GYM_ALLOWED = r".*is different from the unwrapped version.*"


def below(env: gymnasium.Env) -> gymnasium.Env:
    """The environment that an entry point made, without gymnasium's own wrappers."""
    while not isinstance(env, GoalActions) and env is not env.unwrapped:
        env = env.env
    return env


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("actions", ACTIONS)
@pytest.mark.parametrize("observation", FORMATS)
def test_gymnasium_check_env_without_a_warning(name, actions, observation):
    fields = {"actions": actions, "observation": observation, "laser": SMALL["laser"]} | NEEDED.get(name, {})
    env = gymnasium.make(name, disable_env_checker=True, **fields)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=GYM_ALLOWED)
        check_env(below(env), skip_render_check=True)


@pytest.mark.parametrize("actions", ACTIONS)
def test_render_modes_pass_the_check(actions):
    env = make(actions=actions, render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=GYM_ALLOWED)
        check_env(below(env), skip_close_check=True)


@pytest.mark.parametrize("actions", ACTIONS)
@pytest.mark.parametrize("observation", FORMATS)
def test_stable_baselines3_check_env(actions, observation):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    env = make(actions=actions, observation=observation)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        checker.check_env(env, warn=True, skip_render_check=True)
    messages = [str(w.message) for w in caught if issubclass(w.category, UserWarning)]
    assert [m for m in messages if observation != "dict" or not m.startswith(SB3_ALLOWED)] == []


@pytest.mark.parametrize("actions", ACTIONS)
@pytest.mark.parametrize("parts", [{}, {"map": True, "scan": True}, "flat", "image"], ids=str)
def test_observations_stay_in_their_space_and_info_keeps_its_form(actions, parts):
    env = make(actions=actions, observation=parts, max_steps=40, start="random")
    env.action_space.seed(3)
    observation, first = env.reset(seed=3)
    assert observation in env.observation_space
    for _ in range(60):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert observation in env.observation_space
        assert type(reward) is float
        assert np.isfinite(reward)
        assert type(terminated) is bool
        assert type(truncated) is bool
        assert form(info) == form(first)
        assert all(np.isfinite(value).all() for value in info.values() if not isinstance(value, str))
        assert np.isclose(sum(v for k, v in info.items() if k.startswith("reward_")), reward) or actions == "goal"
        if terminated or truncated:
            env.reset()


def form(info):
    return {key: (type(value), getattr(value, "shape", None)) for key, value in info.items()}


def test_observations_share_no_memory():
    env = make(observation={"map": True, "scan": True})
    first, _ = env.reset(seed=1)
    kept = copy.deepcopy(first)
    second = env.step(np.ones(2, np.float32))[0]
    assert not any(np.shares_memory(first[key], second[key]) for key in first)
    assert data_equivalence(first, kept, exact=True)


@pytest.mark.parametrize("name", IDS)
def test_the_spec_survives_json(name):
    own = {"layout": load_layout("two_rooms")} if "Layout" in name else NEEDED.get(name, {})
    env = gymnasium.make(name, config=EnvConfig.build(max_steps=9), actions="goal", **own)
    spec = EnvSpec.from_json(env.spec.to_json())
    json.dumps(env.unwrapped.spec.kwargs)
    assert spec.max_episode_steps == env.unwrapped.config.max_steps
    again = gymnasium.make(spec)
    assert again.unwrapped.config == env.unwrapped.config
    assert type(below(again)) is GoalActions
    assert str(again) == f"<TimeLimit{env}>"  # of the same limit, which the environment has by itself
    assert data_equivalence(again.reset(seed=1)[0], env.reset(seed=1)[0], exact=True)


def test_registration_is_idempotent_and_both_forms_of_make_work():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mecp_env.register_environments()
    assert gymnasium.make("mecp_env:mecp_env/Layout-v0").unwrapped.config.layout == "two_rooms"
    assert gymnasium.make("mecp_env/PaperMap-v0").unwrapped.config.layout == "paper"
    assert gymnasium.make("mecp_env/Layout-v0", config={"layout": "office"}).unwrapped.config.layout == "office"


@pytest.mark.parametrize(
    "keywords", [{"layout": "twins"}, {"config": {"layout": "twins"}}, {"config": EnvConfig(layout="twins")}], ids=str
)
def test_the_paper_map_takes_no_other_layout(keywords):
    with pytest.raises(ConfigError, match=r"layout: .*PaperMap-v0 is 'paper'"):
        gymnasium.make("mecp_env/PaperMap-v0", **keywords)
    same = gymnasium.make("mecp_env/PaperMap-v0", layout="paper", config={"layout": "paper", "max_steps": 9})
    assert (same.unwrapped.config.layout, same.unwrapped.config.max_steps) == ("paper", 9)


def test_importing_the_package_is_light():
    code = (
        "import sys, mecp_env; heavy = {'numba', 'scipy', 'matplotlib', 'pygame', 'pymunk', 'shapely', 'pydantic'};"
        "print(sorted(heavy & set(sys.modules)))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


@pytest.mark.parametrize("actions", ACTIONS)
def test_sync_vector_environment(actions):
    venv = gymnasium.make_vec(
        "mecp_env/Layout-v0", num_envs=3, vectorization_mode="sync", actions=actions, max_steps=15, **SMALL
    )
    venv.action_space.seed(1)
    observation, _ = venv.reset(seed=5)
    single = make(actions=actions, max_steps=15)
    alone, _ = single.reset(seed=6)
    assert all(np.array_equal(observation[key][1], alone[key]) for key in alone)
    for _ in range(20):
        observation, reward, _, _, info = venv.step(venv.action_space.sample())
        assert observation in venv.observation_space
        assert reward.shape == (3,)
        assert info["truth_pose"].shape == (3, 3)
    venv.close()


@pytest.mark.slow
def test_async_and_sync_vector_environments_agree():
    rollouts = []
    for mode in ("sync", "async"):
        venv = gymnasium.make_vec("mecp_env/Layout-v0", num_envs=2, vectorization_mode=mode, max_steps=6, **SMALL)
        rows = [venv.reset(seed=5)]
        rows += [venv.step(np.full((2, 2), 0.5, np.float32)) for _ in range(10)]
        rollouts.append([row[0] for row in rows] + [row[1] for row in rows[1:]])
        venv.close()
    assert data_equivalence(rollouts[0], rollouts[1], exact=True)


@pytest.mark.slow
def test_policies_of_stable_baselines3_take_the_observation_and_the_mask():
    contrib = pytest.importorskip("sb3_contrib")
    model = contrib.MaskablePPO("MultiInputPolicy", make(actions="goal", max_steps=30), n_steps=16, batch_size=16)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model.learn(16)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_autoreset_modes(mode):
    venv = gymnasium.make_vec(
        "mecp_env/Layout-v0",
        num_envs=2,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": mode},
        max_steps=3,
        **SMALL,
    )
    venv.reset(seed=1)
    ended = 0
    for _ in range(9):
        _, _, _, truncated, info = venv.step(np.zeros((2, 2), np.float32))
        ended += truncated.all()
    assert ended >= 2
    assert (info["period"] <= 3).all()
    venv.close()


def test_common_wrappers():
    env = gymnasium.wrappers.RecordEpisodeStatistics(gymnasium.wrappers.TimeLimit(make(), 4))
    env.reset(seed=1)
    for _ in range(4):
        *_, truncated, info = env.step(np.zeros(2, np.float32))
    assert truncated
    assert info["episode"]["l"] == 4
    flat = gymnasium.wrappers.FlattenObservation(make())
    assert flat.reset(seed=1)[0] in flat.observation_space


def test_render_without_a_mode_says_so_and_close_may_be_called_twice():
    env = make().unwrapped
    env.reset(seed=1)
    with pytest.warns(UserWarning, match="render_mode"):
        assert env.render() is None
    env.close()
    env.close()


def test_a_frame_is_a_picture():
    env = make(render_mode="rgb_array")
    env.reset(seed=1)
    frame = env.render()
    assert frame.dtype == np.uint8
    assert frame.ndim == 3
    assert frame.shape[2] == 3
    assert frame.std() > 0
    env.step(np.ones(2, np.float32))
    assert not np.array_equal(frame, env.render())


def test_the_window_of_human_mode_draws_itself(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = make(render_mode="human")
    env.reset(seed=1)
    env.step(np.ones(2, np.float32))
    assert env.render() is None
    env.close()
    env.reset(seed=1)  # a new window
    env.close()


@pytest.mark.slow
def test_no_display_is_touched_for_a_picture():
    code = (
        "import gymnasium, mecp_env, pygame; env = gymnasium.make('mecp_env/Layout-v0', render_mode='rgb_array');"
        "env.reset(seed=1); env.render(); print(pygame.display.get_init())"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.split()[-1] == "False"


def test_a_video_can_be_recorded_frame_by_frame():
    env = gymnasium.wrappers.RenderCollection(make(render_mode="rgb_array"))
    env.reset(seed=1)
    for _ in range(3):
        env.step(np.zeros(2, np.float32))
    assert len(env.render()) == 4


def test_the_docstring_is_the_spec_sheet():
    text = type(make().unwrapped).__doc__
    sections = [line[3:] for line in text.replace("    ", "").splitlines() if line.startswith("## ")]
    assert sections == [
        "Description",
        "Action Space",
        "Observation Space",
        "Rewards",
        "Starting State",
        "Episode End",
        "Arguments",
        "Vectorized environment",
        "Version History",
    ]
    assert all(f"`{name}`" in text for name in EnvConfig.model_fields)


def test_the_spec_has_the_limit_of_the_episode():
    assert gymnasium.make("mecp_env/Rooms-v0", max_steps=70).spec.max_episode_steps == 70
    assert gymnasium.make("mecp_env/Rooms-v0", max_steps=70, max_episode_steps=9).spec.max_episode_steps == 9
    env = gymnasium.make("mecp_env/Layout-v0", layout="two_rooms", actions="goal", max_steps=70)
    assert env.spec.max_episode_steps == 70


def test_human_without_a_display_warns_once(monkeypatch, caplog):
    from mecp_env.render import window

    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr(window, "is_unseen", lambda driver: driver == "dummy")
    window.warn_unseen.cache_clear()
    for _ in range(2):
        env = gymnasium.make("mecp_env/Layout-v0", layout="two_rooms", render_mode="human")
        env.reset(seed=0)
        env.close()
    assert caplog.text.count("nothing can be seen") == 1
