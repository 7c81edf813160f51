"""States and maps at random moments come back to the bit; a door that a wall fills is part of both."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from benchmarks import restore
from mecp_env.slam import MapError, SlamPipeline
from mecp_env.slam.map_file import SlamMap
from tests.env.helpers import drive, episode_of, make, same

FEW = 20


@pytest.mark.slow
@pytest.mark.parametrize("number", range(FEW))
def test_a_random_state_and_its_map_are_restored(number: int) -> None:
    assert restore.failure_of((number,)) == ""


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
    env = make().unwrapped
    env.reset(seed=1)
    drive(env, 3)
    pipeline = copy.deepcopy(episode_of(env).pipeline)
    owner = pipeline
    for name in path[:-1]:
        owner = getattr(owner, name)
    setattr(owner, path[-1], value)
    with pytest.raises(MapError, match=path[-1]):
        SlamMap.of(pipeline)
