"""States and maps at random moments come back to the bit; what is damaged is named."""

import copy
import pickle
from functools import reduce

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from benchmarks import restore
from mecp_env.core.errors import MecpError
from mecp_env.slam import MapError
from mecp_env.slam.map_file import SlamMap
from tests.env.helpers import drive, episode_of, make, same, started

BUSY = {"crowd": {"people": 4}, "clutter": {"movable_boxes": 3, "closed_doors": 0.3}, "layout": "paper"}


def test_a_running_environment_continues_bit_for_bit():
    env, other = make(**BUSY).unwrapped, make(**BUSY).unwrapped
    env.reset(seed=4)
    drive(env, 30)
    other.set_state(env.get_state())
    twins = other, pickle.loads(pickle.dumps(env)), copy.deepcopy(env)
    rows = drive(env, 40, seed=2)
    assert all(same(rows, drive(twin, 40, seed=2)) for twin in twins)


def test_after_set_state_a_never_reset_environment_steps_without_its_wrappers():
    """As documented in the docstring of `set_state`."""
    env, other = started(), copy.deepcopy(make())
    other.unwrapped.set_state(env.get_state())
    with pytest.raises(ResetNeeded):
        drive(other, 3)
    assert same(drive(other.unwrapped, 3), drive(env, 3))


def with_field(state, name, value):
    """The state with another value of a field of the episode; `...` leaves it out."""
    kind, fields = state["episode"]["@object"]
    fields = {key: item for key, item in fields.items() if key != name} | ({} if value is ... else {name: value})
    return state | {"episode": {"@object": [kind, fields]}}


DAMAGES = [
    (lambda s: None, "state"),
    (lambda s: s | {"format": "x"}, "get_state"),
    (lambda s: s | {"version": 99}, "version"),
    (lambda s: s | {"config": make(max_steps=7).unwrapped.config.to_json()}, "another configuration: max_steps"),
    (lambda s: s | {"random": {}}, "random|damaged"),
    (lambda s: with_field(s, "metrics", ...), "metrics"),
    (lambda s: with_field(s, "metrics", None), r"episode\.metrics: expected EpisodeMetrics"),
    (lambda s: with_field(s, "goals_key", {"@tuple": [1, "x"]}), r"episode\.goals_key"),
    (lambda s: with_field(s, "extra", 3), "extra"),
    (lambda s: s | {"simulation": {"@dict": [["body", 3.0]]}}, "simulation"),
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


def test_a_door_that_a_wall_fills_is_part_of_a_state():
    """Its outline is nan: such a state was refused once."""
    env = started()
    doors = episode_of(env).pipeline.grid.doors
    doors.key, doors.quads = ((0, (1, 2), None),), np.full((1, 4, 2), np.nan)
    state = env.get_state()
    env.set_state(state)
    assert same(env.get_state(), state)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(10))
def test_a_random_state_and_its_map_are_restored(number: int) -> None:
    assert restore.failure_of((number,)) == ""


@pytest.mark.parametrize(
    ("path", "value"), [("step_count", 2**60), ("grid.completed", (-1,)), ("grid.canvas.resolution_m", 1e-9)]
)
def test_a_map_that_would_fail_in_a_step_is_refused(path: str, value: object) -> None:
    pipeline = copy.deepcopy(episode_of(started()).pipeline)
    *parents, name = path.split(".")
    setattr(reduce(getattr, parents, pipeline), name, value)
    with pytest.raises(MapError, match=name):
        SlamMap.of(pipeline)
