"""`Rooms-v0`: a new building at every reset, the same one for the same seed, state and options."""

from __future__ import annotations

import pickle

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence

import mecp_env  # noqa: F401
from mecp_env.core.errors import ConfigError
from mecp_env.core.snapshot import StateError
from mecp_env.world.generator import SPLITS, GeneratorSpec, generate, split_seed
from mecp_env.world.outline import build_outline

ROOMS = "mecp_env/Rooms-v0"
EASY = {"difficulty": "easy", "rooms": 3, "laser": {"sweeps": 1}, "max_steps": 20}


def drive(env: gymnasium.Env, steps: int = 5) -> list:
    return [env.step(np.array([0.4, 0.3 * (step % 3 - 1)], np.float32)) for step in range(steps)]


def test_every_reset_is_a_building_of_the_split_and_a_seed_names_it() -> None:
    env = gymnasium.make(ROOMS, split="validation", **EASY).unwrapped
    buildings = [env.reset(seed=3)[1]["building"], *(env.reset()[1]["building"] for _ in range(5))]
    assert len(set(buildings)) > 4
    assert all(0 <= number < len(SPLITS["validation"]) for number in buildings)
    layout = generate(GeneratorSpec.preset("easy", rooms=3), split_seed("validation", buildings[-1]))
    assert np.array_equal(env.view().segments, build_outline(layout).segments)
    again = gymnasium.make(ROOMS, split="validation", **EASY)
    assert [again.reset(seed=3)[1]["building"], *(again.reset()[1]["building"] for _ in range(5))] == buildings


def test_a_building_can_be_chosen() -> None:
    env = gymnasium.make(ROOMS, **EASY)
    first = env.reset(seed=1, options={"building": 12})
    assert first[1]["building"] == 12
    drive(env)
    second = env.reset(seed=1, options={"building": 12})
    assert data_equivalence(first, second, exact=True)


def test_one_environment_is_as_many_made_anew() -> None:
    """An earlier building does not affect the next one."""
    used, fresh = gymnasium.make(ROOMS, **EASY), gymnasium.make(ROOMS, **EASY)
    used.reset(seed=4)
    drive(used)
    assert data_equivalence(used.reset(seed=9), fresh.reset(seed=9), exact=True)
    assert data_equivalence(drive(used), drive(fresh), exact=True)


def test_a_state_knows_its_building() -> None:
    env, other = gymnasium.make(ROOMS, **EASY).unwrapped, gymnasium.make(ROOMS, **EASY).unwrapped
    env.reset(seed=5)
    drive(env, 3)
    state = env.get_state()
    other.reset(seed=6)
    other.set_state(state)
    copied = pickle.loads(pickle.dumps(env))
    expected = drive(env)
    assert data_equivalence(drive(other), expected, exact=True)
    assert data_equivalence(drive(copied), expected, exact=True)
    with pytest.raises(StateError, match=r"state.building: -3"):
        other.set_state(state | {"building": -3})


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"building": 1_000_000}, "1000000"),
        ({"building": -1}, "-1"),
        ({"building": 1.5}, "whole number"),
        ({"building": True}, "whole number"),
        ({"start": (0.0, 0.0, 0.0)}, "buildings that change"),
    ],
)
def test_a_wrong_option_is_refused_and_nothing_changed(options: dict, named: str) -> None:
    env = gymnasium.make(ROOMS, **EASY).unwrapped
    env.reset(seed=2)
    before = pickle.dumps(env.get_state())
    with pytest.raises(ConfigError, match=named):
        env.reset(seed=8, options=options)
    assert pickle.dumps(env.get_state()) == before


@pytest.mark.parametrize(
    ("keywords", "named"),
    [
        ({"difficulty": "brutal"}, "difficulty"),
        ({"split": "dev"}, "split"),
        ({"rooms": 1}, "rooms"),
        ({"layout": "paper"}, "makes its own"),
        ({"roms": 3}, "roms"),
        ({"start": (0.0, 0.0, 0.0)}, "start"),
    ],
)
def test_a_wrong_keyword_is_refused(keywords: dict, named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        gymnasium.make(ROOMS, **keywords)


def test_the_configuration_of_one_makes_another() -> None:
    env = gymnasium.make(ROOMS, **EASY)
    again = gymnasium.make(ROOMS, config=env.unwrapped.config, split="test")
    assert again.unwrapped.config.layout == {"generate": {"difficulty": "easy", "rooms": 3, "split": "test"}}
    with pytest.raises(ConfigError, match="stands alone"):
        gymnasium.make("mecp_env/Layout-v0", layout={"generate": {}, "name": "x"})


@pytest.mark.parametrize(
    ("keywords", "named"),
    [
        ({"lops": 2}, r"Rooms-v0\(\) got an unexpected keyword argument 'lops'; did you mean 'loops'"),
        ({"door_width": 0.9}, r"did you mean 'door_width_m'"),
        ({"max_step": 9}, r"did you mean 'max_steps'"),
        ({"difficulty": "medum"}, r"difficulty: 'medum' .*did you mean 'medium'"),
        ({"split": "tst"}, r"split: 'tst' .*did you mean 'test'"),
        ({"estimator": "slamm"}, r"EnvConfig\.estimator: .*did you mean 'slam'"),
        ({"loops": 20}, r"loops: 20 loops, at most 10 with 8 rooms"),
    ],
)
def test_a_wrong_keyword_gets_a_guess_or_the_bound(keywords: dict, named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        gymnasium.make(ROOMS, **keywords)


def test_a_single_width_is_a_range() -> None:
    assert gymnasium.make(ROOMS, door_width_m=0.9, difficulty="easy").reset(seed=0)[1]["rooms"] == 4
