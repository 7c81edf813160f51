"""States and maps at random moments come back to the bit; a door that a wall fills is part of both."""

import copy
import pickle
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from benchmarks import restore
from mecp_env.core.errors import MecpError
from mecp_env.slam import MapError, SlamPipeline
from mecp_env.slam.map_file import SlamMap
from tests.env.helpers import drive, episode_of, make, same, started
from tests.env.test_movers import BUSY


def only_plain(data):
    if isinstance(data, list):
        return all(only_plain(item) for item in data)
    if isinstance(data, dict):
        return all(type(key) is str and only_plain(item) for key, item in data.items())
    return type(data) in (type(None), bool, int, float, str) or isinstance(data, np.ndarray)


def test_a_state_is_plain_data_and_shares_no_memory():
    env = started()
    drive(env, 5)
    state = env.get_state()
    assert only_plain(state)
    before = copy.deepcopy(state)
    drive(env, 5)
    assert same(state, before)


@pytest.mark.parametrize("keywords", [{"laser": {"preset": "paper"}}, BUSY], ids=["noise", "moving"])
def test_a_running_environment_continues_bit_for_bit(keywords):
    env, other = make(**keywords).unwrapped, make(**keywords).unwrapped
    env.reset(seed=4)
    drive(env, 30)
    other.set_state(env.get_state())
    twins = other, pickle.loads(pickle.dumps(env)), copy.deepcopy(env)
    rows = drive(env, 40, seed=2)
    assert all(same(rows, drive(twin, 40, seed=2)) for twin in twins)


def test_after_set_state_a_never_reset_environment_steps_without_its_wrappers_and_after_a_reset_with_them():
    """As documented in the docstring of `set_state`."""
    env = make()
    env.reset(seed=4)
    state = env.unwrapped.get_state()
    expected = drive(env, 3)
    other = copy.deepcopy(make())
    other.unwrapped.set_state(state)
    with pytest.raises(ResetNeeded):
        drive(other, 3)
    assert same(drive(other.unwrapped, 3), expected)
    other.reset(seed=1)
    other.unwrapped.set_state(state)
    assert same(drive(other, 3), expected)


def with_field(state, name, value):
    """The state with another value of a field of the episode; `...` leaves it out."""
    kind, fields = state["episode"]["@object"]
    fields = {key: item for key, item in fields.items() if key != name} | ({} if value is ... else {name: value})
    return state | {"episode": {"@object": [kind, fields]}}


def without(state, name):
    return {key: value for key, value in state.items() if key != name}


DAMAGES = [
    (lambda s: None, "state"),
    (lambda s: {}, "state"),
    (lambda s: s | {"format": "x"}, "get_state"),
    (lambda s: s | {"version": 99}, "version"),
    (lambda s: s | {"config": make(max_steps=7).unwrapped.config.to_dict()}, "config"),
    (lambda s: s | {"config": make(max_steps=7).unwrapped.config.to_json()}, "another configuration: max_steps"),
    (lambda s: without(s, "random"), "random"),
    (lambda s: s | {"random": {}}, "random|damaged"),
    (lambda s: with_field(s, "metrics", ...), "metrics"),
    (lambda s: with_field(s, "metrics", None), r"episode\.metrics: expected EpisodeMetrics"),
    (lambda s: with_field(s, "over", "yes"), r"episode\.over: expected bool, given 'yes'"),
    (lambda s: with_field(s, "goals_step", True), r"episode\.goals_step: expected int"),
    (lambda s: with_field(s, "goals_key", {"@tuple": [1, "x"]}), r"episode\.goals_key"),
    (lambda s: with_field(s, "target", {"@array": [np.zeros(2, np.int64), True]}), r"episode\.target"),
    (lambda s: with_field(s, "extra", 3), "extra"),
    (lambda s: s | {"episode": None}, "episode"),
    (lambda s: s | {"episode": {"@list": []}}, "episode"),
    (lambda s: s | {"simulation": {"@dict": [["body", 3.0]]}}, "simulation"),
    (lambda s: s | {"seed": "x"}, "seed"),
    (lambda s: s | {"seed": True}, "seed"),
]


def test_set_state_names_the_field_that_is_damaged_and_changes_nothing():
    env = started()
    drive(env, 5)
    state = env.get_state()
    drive(env, 3)
    before = env.get_state()
    for damage, named in DAMAGES:
        with pytest.raises(MecpError, match=named):
            env.set_state(damage(copy.deepcopy(state)))
        assert same(env.get_state(), before)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(20))
def test_a_random_state_and_its_map_are_restored(number: int) -> None:
    assert restore.failure_of((number,)) == ""


@pytest.mark.slow
def test_a_difference_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(restore, "same", lambda first, second: False)
    assert "another state" in restore.failure_of((1,))


@pytest.mark.slow
def test_a_door_that_a_wall_fills(tmp_path: Path) -> None:
    keywords = {"max_steps": 600, "crowd": {"people": 4}, "clutter": {"movable_boxes": 0, "closed_doors": 0}}
    env = gym.make("mecp_env/ActiveCheapRobot-v0", disable_env_checker=True, actions="goal", **keywords)
    env.reset(seed=785)
    env.step(0)
    own = env.unwrapped
    assert np.isnan(episode_of(own).pipeline.grid.doors.quads).any()
    state = own.get_state()
    own.set_state(state)
    assert same(own.get_state(), state)
    assert same(pickle.loads(pickle.dumps(env)).unwrapped.get_state(), state)
    assert same(copy.deepcopy(env).unwrapped.get_state(), state)
    own.save_map(tmp_path / "map.zip")
    SlamPipeline.from_map(tmp_path / "map.zip")


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("step_count",), 2**60),
        (("grid", "completed"), ("a", "b")),
        (("grid", "completed"), (-1,)),
        (("grid", "canvas", "resolution_m"), 1e-9),
    ],
)
def test_a_map_that_would_fail_in_a_step_is_refused(path: tuple[str, ...], value: object) -> None:
    env = started()
    drive(env, 3)
    pipeline = copy.deepcopy(episode_of(env).pipeline)
    owner = pipeline
    for name in path[:-1]:
        owner = getattr(owner, name)
    setattr(owner, path[-1], value)
    with pytest.raises(MapError, match=path[-1]):
        SlamMap.of(pipeline)
