"""The contracts of Gymnasium and Stable-Baselines3, over every registered id and kind of action."""

import copy
import json

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env, data_equivalence

import mecp_env
from mecp_env.config import EnvConfig
from mecp_env.core.errors import ConfigError
from mecp_env.render import window
from mecp_env.world.layout import load_layout
from mecp_env.wrappers import GoalActions
from tests.env.helpers import IDS, NEEDED, SMALL, below, make, started

ACTIONS = ("velocity", "discrete", "goal")
FORMATS = ("dict", "flat", "image")
KINDS = [("mecp_env/Layout-v0", *kinds) for kinds in zip(ACTIONS, FORMATS, strict=True)]


@pytest.mark.filterwarnings("ignore:.*is different from the unwrapped version")  # of goal actions, by design
@pytest.mark.parametrize(("name", "actions", "observation"), [*((name, None, None) for name in IDS), *KINDS])
def test_gymnasium_check_env_without_a_warning(name, actions, observation):
    fields = {"actions": actions, "observation": observation, "render_mode": "rgb_array"} if actions else {}
    env = gymnasium.make(name, disable_env_checker=True, laser=SMALL["laser"], **fields, **NEEDED.get(name, {}))
    check_env(below(env), skip_render_check=not actions, skip_close_check=bool(actions))


@pytest.mark.filterwarnings("ignore:Your observation (landmarks|goals) has an unconventional")  # tables, flattened
@pytest.mark.parametrize(("name", "actions", "observation"), KINDS)
def test_stable_baselines3_check_env(name, actions, observation):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(make(actions=actions, observation=observation), warn=True, skip_render_check=True)


@pytest.mark.parametrize("actions", ACTIONS)
@pytest.mark.parametrize("parts", [{}, {"map": True, "scan": True}, "flat", "image"], ids=str)
def test_observations_stay_in_their_space_and_info_keeps_its_form(actions, parts):
    env = make(actions=actions, observation=parts, max_steps=40, start="random")
    env.action_space.seed(3)
    observation, first = env.reset(seed=3)
    assert observation in env.observation_space
    for _ in range(9 if actions == "goal" else 45):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert observation in env.observation_space
        assert (type(reward), type(terminated), type(truncated)) == (float, bool, bool)
        assert form(info) == form(first)
        assert all(np.isfinite(value).all() for value in (reward, *info.values()) if not isinstance(value, str))
        assert np.isclose(sum(v for k, v in info.items() if k.startswith("reward_")), reward) or actions == "goal"
        if parts != "flat":
            left = np.mean(observation[2, -1] == 255) if parts == "image" else observation["budget"][0]
            assert left == pytest.approx(1.0 - info["period"] / 40, abs=0.5 / 64)
        if terminated or truncated:
            env.reset()


@pytest.mark.parametrize("actions", ["velocity", "goal"])
def test_info_is_numbers_alone_where_texts_are_left_out(actions):
    env = make(actions=actions, info_texts=False)
    _, first = env.reset(seed=3)
    *_, info = env.step(env.action_space.sample())
    assert all(np.asarray(value).dtype.kind in "biuf" for value in (first | info).values())
    assert form(make(actions=actions).reset(seed=3)[1] | {"event": ""}) == form(first | {"event": ""})


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
    assert spec.max_episode_steps == env.unwrapped.config.max_steps == 9
    again = gymnasium.make(spec)
    assert again.unwrapped.config == env.unwrapped.config
    assert type(below(again)) is GoalActions
    assert str(again) == f"<TimeLimit{env}>"  # of the same limit, which the environment has by itself
    assert data_equivalence(again.reset(seed=1)[0], env.reset(seed=1)[0], exact=True)


def test_registration_is_idempotent_and_both_forms_of_make_work():
    mecp_env.register_environments()  # again, without a warning
    assert gymnasium.make("mecp_env:mecp_env/Layout-v0").unwrapped.config.layout == "two_rooms"
    assert gymnasium.make("mecp_env/PaperMap-v0").unwrapped.config.layout == "paper"
    assert gymnasium.make("mecp_env/Layout-v0", config={"layout": "office"}).unwrapped.config.layout == "office"
    assert gymnasium.make("mecp_env/Rooms-v0", max_steps=70, max_episode_steps=9).spec.max_episode_steps == 9
    assert [name for name in EnvConfig.model_fields if f"`{name}`" not in type(make().unwrapped).__doc__] == []


def test_the_paper_map_takes_no_other_layout():
    for keywords in ({"layout": "twins"}, {"config": EnvConfig(layout="twins")}):
        with pytest.raises(ConfigError, match=r"layout: .*PaperMap-v0 is 'paper'"):
            gymnasium.make("mecp_env/PaperMap-v0", **keywords)


def test_human_mode_draws_itself_and_warns_once_without_a_display(monkeypatch, caplog):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr(window, "is_unseen", lambda driver: driver == "dummy")
    window.warn_unseen.cache_clear()
    with pytest.warns(UserWarning, match="render_mode"):
        assert started().render() is None
    env = make(render_mode="human")
    for _ in range(2):
        env.reset(seed=1)  # a new window
        env.step(np.ones(2, np.float32))
        assert env.render() is None
        env.close()
    assert caplog.text.count("nothing can be seen") == 1
