"""Difficulties for curricula: a list to draw from, and one for an episode by an option of `reset`."""

from __future__ import annotations

import copy
from typing import Any

import gymnasium
import numpy as np
import pytest

from mecp_env.core.errors import ConfigError

ROOMS = {"easy": 4, "medium": 8, "hard": 14}


def make(**keywords: Any) -> gymnasium.Env:
    return gymnasium.make("mecp_env/Rooms-v0", laser={"sweeps": 1, "beams": 180}, **keywords)


def rooms(env: gymnasium.Env, **options: Any) -> int:
    """The rooms of the building of a reset; a corridor is one."""
    *_, info = env.reset(options=options or None)
    return int(info["rooms"])


def test_one_of_a_list_is_drawn_at_every_reset() -> None:
    env = make(difficulty=["easy", "medium"])
    env.reset(seed=0)
    assert {rooms(env) for _ in range(12)} == {ROOMS["easy"], ROOMS["medium"]}
    assert gymnasium.make(env.spec).reset(seed=3)[1]["building"] == env.reset(seed=3)[1]["building"]


def test_an_option_sets_the_difficulty_of_one_episode() -> None:
    env = make(difficulty="easy")
    assert rooms(env, difficulty="hard", building=3) == ROOMS["hard"]
    assert rooms(env) == ROOMS["easy"]
    hard = make(difficulty="hard")
    hard.reset(options={"building": 3})
    env.reset(options={"difficulty": "hard", "building": 3})
    assert np.array_equal(env.unwrapped.view().segments, hard.unwrapped.view().segments)


def test_buildings_of_a_single_difficulty_keep_their_numbers() -> None:
    one, several = make(difficulty="easy"), make(difficulty=["easy", "hard"])
    assert one.reset(options={"building": 5})[1]["building"] == 5
    assert several.reset(options={"building": 5})[1]["building"] == 5
    assert np.array_equal(one.unwrapped.view().segments, several.unwrapped.view().segments)


def test_a_state_continues_in_its_building_of_another_difficulty() -> None:
    env, other = make(), make()
    env.reset(seed=1, options={"difficulty": "easy"})
    other.reset(seed=2)
    other.unwrapped.set_state(env.unwrapped.get_state())
    action = np.array([0.5, 0.2], np.float32)
    assert env.step(action)[1:4] == other.step(action)[1:4]
    assert copy.deepcopy(env.unwrapped).info()["rooms"] == ROOMS["easy"]


def test_a_batch_takes_lists_and_options() -> None:
    envs = gymnasium.make_vec("mecp_env/Rooms-v0", 2, difficulty=["easy", "medium"], laser={"sweeps": 1, "beams": 180})
    *_, infos = envs.reset(options={"difficulty": "easy"})
    assert infos["rooms"].tolist() == [ROOMS["easy"]] * 2
    envs.close()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"difficulty": "esy"}, "did you mean 'easy'"),
        ({"difficulty": []}, "a list of them"),
        ({"difficulty": ["easy", "hrad"]}, "did you mean 'hard'"),
        ({"difficulty": 3}, "a list of them"),
    ],
)
def test_wrong_difficulties_are_refused(given: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        make(**given)


def test_wrong_options_are_refused() -> None:
    with pytest.raises(ConfigError, match="did you mean 'easy'"):
        make().reset(options={"difficulty": "esy"})
    with pytest.raises(ConfigError, match="only generated buildings"):
        gymnasium.make("mecp_env/PaperMap-v0").reset(options={"difficulty": "easy"})
    with pytest.raises(ConfigError, match="building: 1000000, there are 1000000"):
        make().reset(options={"difficulty": "easy", "building": 1_000_000})
