from __future__ import annotations

import copy
import pickle
from dataclasses import dataclass

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from mecp_env.core.errors import MecpError
from mecp_env.core.snapshot import StateError, decode, encode
from mecp_env.episode.observations import TravelledPath
from mecp_env.slam.messages import Cell, CornerKind, FeatureTable
from mecp_env.world.config import LaserConfig
from tests.env.helpers import drive, episode_of, make, same

VALUES = [
    None,
    True,
    3,
    -0.0,
    float("nan"),
    "text",
    [],
    (),
    (1, (2.0, "x")),
    {1: "a", (2, 3): [4]},
    {"@list": 1},
    {3, 1, 2},
    frozenset({2}),
    np.float64(1.5),
    np.int64(7),
    np.bool_(True),
    np.arange(6.0).reshape(2, 3),
    np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    np.empty((0, 2)),
    np.array(["a", "b"]),
    Cell.DOOR,
    CornerKind.JAMB,
    LaserConfig(preset="ideal"),
    TravelledPath(),
    FeatureTable(),
]


@pytest.mark.parametrize("value", VALUES, ids=lambda v: f"{v!r:.30}")
def test_values_come_back_to_the_last_bit(value):
    again = decode(encode(value))
    assert same(again, value)
    assert type(again) is type(value)


def only_plain(data):
    if isinstance(data, list):
        return all(only_plain(item) for item in data)
    if isinstance(data, dict):
        return all(type(key) is str and only_plain(item) for key, item in data.items())
    return type(data) in (type(None), bool, int, float, str) or isinstance(data, np.ndarray)


def test_a_state_is_plain_data_and_shares_no_memory():
    env = make().unwrapped
    env.reset(seed=1)
    drive(env, 5)
    state = env.get_state()
    assert only_plain(state)
    before = copy.deepcopy(state)
    drive(env, 5)
    assert same(state, before)


def test_what_is_shared_stays_shared_and_cycles_hold():
    array = np.zeros(3)
    pair = [array, array, (array,)]
    pair.append(pair)
    again = decode(encode(pair))
    assert again[0] is again[1] is again[2][0]
    assert again[3] is again


def test_an_array_stays_read_only():
    array = np.zeros(3)
    array.setflags(write=False)
    assert not decode(encode(array)).flags.writeable


def test_a_generator_continues():
    rng = np.random.default_rng(5)
    rng.normal(size=3)
    again = decode(encode(rng))
    assert again.normal() == rng.normal()


@dataclass
class Foreign:
    x: int = 1


@pytest.mark.parametrize(
    "value",
    [print, lambda: 1, Foreign(), object(), np.array([None]), (n for n in "ab")],
    ids=lambda value: type(value).__name__,
)
def test_what_no_state_may_hold_is_refused(value):
    with pytest.raises(TypeError):
        encode(value)


@pytest.mark.parametrize(
    "data",
    [
        (1, 2),
        {},
        {"@list": [], "@dict": []},
        {"list": []},
        {"@nothing": 1},
        {"@same": 3},
        {"@same": -1},
        {"@object": ["os:system", {}]},
        {"@object": ["mecp_env.nowhere:X", {}]},
        {"@object": ["mecp_env.core.snapshot:encode", {}]},
        {"@enum": ["mecp_env.slam.messages:FeatureTable", 1]},
        {"@settings": ["mecp_env.slam.messages:FeatureTable", {}]},
        {"@generator": {"bit_generator": "PCG64"}},
        {"@generator": None},
        {"@array": None},
        {"@array": [1]},
        {"@array": [np.zeros(2), "x", 3][:1]},
        {"@dict": [[1]]},
        {"@dict": [[{"@list": []}, 1]]},
        {"@list": 3},
        {"@scalar": 3},
        {"@enum": ["mecp_env.slam.messages:Cell", 99]},
        {"@object": ["mecp_env.episode.observations:TravelledPath", {"nothing_such": 1}]},
        {"@object": 3},
        {"@same": "x"},
    ],
    ids=str,
)
def test_damaged_data_is_refused(data):
    with pytest.raises(StateError):
        decode(data)


@pytest.mark.parametrize("method", ["set_state", "pickle", "deepcopy"])
def test_a_running_environment_continues_bit_for_bit(method):
    env = make(laser={"preset": "paper"}).unwrapped
    env.reset(seed=4)
    drive(env, 30)
    if method == "set_state":
        other = make(laser={"preset": "paper"}).unwrapped
        other.set_state(env.get_state())
    else:
        other = pickle.loads(pickle.dumps(env)) if method == "pickle" else copy.deepcopy(env)
    assert same(drive(env, 40, seed=2), drive(other, 40, seed=2))


def test_after_set_state_a_never_reset_environment_steps_without_its_wrappers_and_after_a_reset_with_them():
    """As documented in the docstring of `set_state`."""
    env = make()
    env.reset(seed=4)
    state = env.unwrapped.get_state()
    expected = drive(env, 3)
    other = make()
    other.unwrapped.set_state(state)
    with pytest.raises(ResetNeeded):
        drive(other, 3)
    assert same(drive(other.unwrapped, 3), expected)
    other.reset(seed=1)
    other.unwrapped.set_state(state)
    assert same(drive(other, 3), expected)


@pytest.mark.slow
def test_continues_bit_for_bit_from_fifty_random_points():
    env, other = make(laser={"preset": "paper"}).unwrapped, make(laser={"preset": "paper"}).unwrapped
    env.reset(seed=9)
    rng = np.random.default_rng(1)
    contacts = 0
    for point in range(50):
        drive(env, int(rng.integers(1, 12)), seed=point)
        state = env.get_state()
        contacts += bool(episode_of(env).contact)
        rows = drive(env, 8, seed=100 + point)
        other.set_state(state)
        assert same(rows, drive(other, 8, seed=100 + point)), point
        env.set_state(state)
    assert contacts > 0  # some of the points lie in a contact with a wall


def test_set_state_refuses_what_does_not_fit_and_changes_nothing():
    env, other = make().unwrapped, make(max_steps=7).unwrapped
    env.reset(seed=1)
    other.reset(seed=2)
    state = env.get_state()
    before = other.get_state()
    damaged = [
        None,
        {},
        state | {"format": "x"},
        state | {"version": 99},
        state,  # of another configuration
        {key: value for key, value in state.items() if key != "random"} | {"config": before["config"]},
        state | {"config": before["config"], "episode": {"@list": []}},
        state | {"config": before["config"], "random": {}},
        state | {"config": before["config"], "simulation": {"@dict": []}},
    ]
    for data in damaged:
        with pytest.raises(MecpError):
            other.set_state(data)
        assert same(other.get_state(), before)


def with_field(state, name, value):
    """The state with another value of a field of the episode; `...` leaves it out."""
    kind, fields = state["episode"]["@object"]
    fields = {key: item for key, item in fields.items() if key != name} | ({} if value is ... else {name: value})
    return state | {"episode": {"@object": [kind, fields]}}


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (lambda s: with_field(s, "metrics", ...), "metrics"),
        (lambda s: with_field(s, "metrics", None), r"episode\.metrics: expected EpisodeMetrics"),
        (lambda s: with_field(s, "over", "yes"), r"episode\.over: expected bool, given 'yes'"),
        (lambda s: with_field(s, "goals_step", True), r"episode\.goals_step: expected int"),
        (lambda s: with_field(s, "goals_key", {"@tuple": [1, "x"]}), r"episode\.goals_key"),
        (lambda s: with_field(s, "target", {"@array": [np.zeros(2, np.int64), True]}), r"episode\.target"),
        (lambda s: with_field(s, "extra", 3), "extra"),
        (lambda s: with_field(s, "pipeline", {"@list": []}), "state: object"),
        (lambda s: s | {"episode": None}, "episode"),
        (lambda s: s | {"simulation": None}, "simulation"),
        (lambda s: s | {"simulation": {"@dict": [["body", 3.0]]}}, "simulation"),
        (lambda s: s | {"seed": "x"}, "seed"),
        (lambda s: s | {"seed": True}, "seed"),
    ],
)
def test_set_state_names_the_field_that_is_damaged_and_changes_nothing(damage, named):
    env = make().unwrapped
    env.reset(seed=1)
    drive(env, 5)
    state = env.get_state()
    drive(env, 3)
    before = env.get_state()
    with pytest.raises(StateError, match=named):
        env.set_state(damage(state))
    assert same(env.get_state(), before)


def damaged_inside(data, cls, name, value):
    """The data with a field of every object of class `cls` set to `value`."""
    if isinstance(data, list):
        return [damaged_inside(item, cls, name, value) for item in data]
    if not isinstance(data, dict):
        return data
    made = {key: damaged_inside(item, cls, name, value) for key, item in data.items()}
    if "@object" in made and made["@object"][0].endswith(f":{cls}"):
        made["@object"][1][name] = value
    return made


@pytest.mark.parametrize(
    ("cls", "name", "value"),
    [
        ("GridPainter", "merges", "none"),
        ("SubmapEkf", "state", None),
        ("SubmapEkf", "gone", 1),
        ("Belief", "pose_cov", {"@list": []}),
        ("MapPolygon", "ids", {"@array": [np.zeros(3), True]}),
        ("RoomGraph", "merged", {"@dict": [["a", 1]]}),
    ],
)
def test_damage_deep_inside_is_found_too(cls, name, value):
    env = make().unwrapped
    env.reset(seed=1)
    state = env.get_state()
    with pytest.raises(StateError, match=rf"state\.episode\..*{name}"):
        env.set_state(state | {"episode": damaged_inside(state["episode"], cls, name, value)})


def test_an_environment_that_never_ran_has_no_state_but_can_be_copied():
    env = make().unwrapped
    with pytest.raises(ResetNeeded):
        env.get_state()
    other = copy.deepcopy(env)
    assert same(env.reset(seed=1), other.reset(seed=1))
