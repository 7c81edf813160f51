"""`Rooms-v0`: a new building at every reset, of a difficulty or of a list of them; the same one for the same seed."""

import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest

from mecp_env.core.errors import ConfigError
from mecp_env.core.snapshot import StateError
from mecp_env.world.config import SPLITS, GeneratorSpec, split_seed
from mecp_env.world.generator import generate
from mecp_env.world.outline import build_outline
from tests.env.helpers import drive, same

ROOMS = {"easy": 4, "medium": 8, "hard": 14}


def make(**keywords: Any) -> gymnasium.Env:
    return gymnasium.make("mecp_env/Rooms-v0", laser={"sweeps": 1, "beams": 180}, **keywords)


def rooms(env: gymnasium.Env, **options: Any) -> int:
    """The rooms of the building of a reset; a corridor is one."""
    *_, info = env.reset(options=options or None)
    return int(info["rooms"])


def test_one_of_a_list_is_drawn_at_every_reset_and_an_option_sets_that_of_one_episode() -> None:
    env = make(difficulty=["easy", "medium"])
    env.reset(seed=0)
    assert {rooms(env) for _ in range(12)} == {ROOMS["easy"], ROOMS["medium"]}
    assert gymnasium.make(env.spec).reset(seed=3)[1]["building"] == env.reset(seed=3)[1]["building"]
    assert rooms(env, difficulty="hard", building=3) == ROOMS["hard"]
    assert env.reset(options={"building": 12})[1]["building"] == 12
    assert rooms(env) != ROOMS["hard"]


def test_a_state_continues_in_its_building_of_another_difficulty() -> None:
    env, other = make(), make()
    env.reset(seed=1, options={"difficulty": "easy"})
    other.reset(seed=2)
    state = env.unwrapped.get_state()
    other.unwrapped.set_state(state)
    assert other.unwrapped.info()["rooms"] == ROOMS["easy"]
    assert same(drive(other.unwrapped, 5), drive(env, 5))
    with pytest.raises(StateError, match=r"state.building: -3"):
        other.unwrapped.set_state(state | {"building": -3})


def test_every_reset_is_a_building_of_the_split_and_a_seed_names_it() -> None:
    env = make(split="validation", difficulty="easy", rooms=3)
    buildings = [env.reset(seed=3)[1]["building"], *(env.reset()[1]["building"] for _ in range(5))]
    assert len(set(buildings)) > 4
    assert all(0 <= number < len(SPLITS["validation"]) for number in buildings)
    layout = generate(GeneratorSpec.preset("easy", rooms=3), split_seed("validation", buildings[-1]))
    assert np.array_equal(env.unwrapped.view().segments, build_outline(layout).segments)
    test = gymnasium.make("mecp_env/Rooms-v0", config=env.unwrapped.config, split="test")
    assert test.unwrapped.config.layout == {"generate": {"difficulty": "easy", "rooms": 3, "split": "test"}}


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"difficulty": "esy"}, "did you mean 'easy'"),
    ({"difficulty": []}, "a list of them"),
    ({"split": "tst"}, r"split: 'tst' .*did you mean 'test'"),
    ({"layout": "paper"}, "makes its own"),
    ({"lops": 2}, r"Rooms-v0\(\) got an unexpected keyword argument 'lops'; did you mean 'loops'"),
    ({"loops": 20}, r"loops: 20 loops, at most 10 with 8 rooms"),
    ({"start": (0.0, 0.0, 0.0)}, "start"),
]
OPTIONS: list[tuple[dict[str, Any], str]] = [
    ({"difficulty": "esy"}, "did you mean 'easy'"),
    ({"difficulty": "easy", "building": 1_000_000}, "building: 1000000, there are 1000000"),
    ({"start": (0.0, 0.0, 0.0)}, "buildings that change"),
]
OPTIONS += [({"building": number}, "-1|whole number") for number in (-1, 1.5, True)]


def test_a_wrong_keyword_or_option_gets_a_guess_or_the_bound_and_nothing_changed() -> None:
    for given, said in WRONG:
        with pytest.raises(ConfigError, match=said):
            gymnasium.make("mecp_env/Rooms-v0", **given)
    env = make(difficulty="easy").unwrapped
    env.reset(seed=2)
    before = pickle.dumps(env.get_state())
    for options, said in OPTIONS:
        with pytest.raises(ConfigError, match=said):
            env.reset(seed=8, options=options)
    assert pickle.dumps(env.get_state()) == before
    with pytest.raises(ConfigError, match="only generated buildings"):
        gymnasium.make("mecp_env/PaperMap-v0").reset(options={"difficulty": "easy"})
