"""The batch as a vector environment: seeds, masks, options, calls, spaces, frames."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.wrappers import FlattenObservation, RecordEpisodeStatistics

from mecp_env.core.errors import ConfigError
from mecp_env.core.processes import start_method
from mecp_env.vector import BatchEnv
from mecp_env.vector import batch as batching
from tests.env.helpers import IDS, NEEDED, SMALL, same
from tests.vector.helpers import LAYOUT, N, make_small, started

STILL = np.zeros((N, 2), np.float32)


@pytest.fixture(scope="module")
def batch() -> BatchEnv:
    return make_small()


@pytest.mark.parametrize("name", IDS)
def test_make_vec_takes_the_batch_for_every_id_and_its_spec_makes_it_again(name: str) -> None:
    venv = gymnasium.make_vec(name, 2, context="fork", laser=SMALL["laser"], **NEEDED.get(name, {}))
    observation, _ = venv.reset(seed=1)
    assert observation in venv.observation_space
    again = gymnasium.make_vec(EnvSpec.from_json(venv.spec.to_json()))
    assert type(venv) is type(again) is BatchEnv
    assert same(observation, again.reset(seed=1)[0])


def test_seeds_are_a_number_or_one_for_each(batch: BatchEnv) -> None:
    first, _ = batch.reset(seed=4)
    assert batch.np_random_seed == (4, 5, 6)
    second, _ = batch.reset(seed=[9, 4, None])
    assert all(same(first[key][0], second[key][1]) for key in first)
    assert batch.np_random_seed == (9, 4, 6)  # an unseeded environment continues its random stream
    assert same(batch.reset(seed=np.int64(4))[0], first)
    for wrong in ([1, 2], 1.5, True, np.bool_(True), -1, "123", [1.7, 2, 3], [True, 1, 2], [1, -2, 3]):
        with pytest.raises(ValueError, match=r"seed: .*one for each of 3"):
            batch.reset(seed=wrong)


def test_a_mask_resets_some_and_shows_the_others_as_they_were(batch: BatchEnv) -> None:
    batch.reset(seed=1)
    before = batch.step(STILL + 0.5)[0]
    options = {"reset_mask": np.array([False, True, False]), "start": [2.0, 2.0, 0.0]}
    after, infos = batch.reset(seed=[0, 1, 2], options=options)
    assert list(options) == ["reset_mask", "start"]  # the arguments of the caller are unchanged
    assert all(same(before[key][[0, 2]], after[key][[0, 2]]) for key in before)
    assert infos["_period"].tolist() == infos["_event"].tolist() == [False, True, False]
    assert batch.step(STILL)[4]["period"].tolist() == [2, 1, 2]
    for mask in ([True, False, True], np.array([1, 0, 1]), np.array([True, False]), np.zeros(N, np.bool_)):
        with pytest.raises((TypeError, ValueError), match="reset_mask"):
            batch.reset(options={"reset_mask": mask})
    with pytest.raises(ConfigError, match="options") as caught:  # others go to each environment
        batch.reset(options={"begin": "random"})
    assert "environment 0 of the batch" in caught.value.__notes__[0]


def test_observations_are_copies_and_views_where_asked_for(batch: BatchEnv) -> None:
    first, _ = batch.reset(seed=1)
    kept = first["pose"].copy()
    batch.step(STILL + 0.9)
    assert same(first["pose"], kept)
    views = make_small(copy=False)
    seen, _ = views.reset(seed=1)
    views.step(STILL + 0.9)
    assert not same(seen["pose"], kept)


@pytest.mark.parametrize("workers", [2, None])
def test_calls_attributes_and_frames(workers: int | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batching, "cores", lambda: 1)  # without a number of workers, all are stepped here
    venv = started(render_mode="rgb_array", workers=workers)
    drawn = [generator.integers(2**40) for generator in venv.np_random]
    assert [generator.integers(2**40) for generator in venv.np_random] == drawn  # copies
    frames = venv.render()
    assert all(frame.shape == frames[0].shape and frame.dtype == np.uint8 and frame.std() > 0 for frame in frames)
    assert [summary["periods"] for summary in venv.call("summary")] == [0] * N
    venv.set_attr("mark", [1, 2, 3])
    assert venv.get_attr("mark") == (1, 2, 3)
    venv.set_attr("mark", "same")
    assert venv.get_attr("mark") == ("same",) * N
    states = venv.call("get_state")
    row = venv.step(STILL + 0.5)
    venv.each(set_state, [(state,) for state in states])
    assert same(venv.step(STILL + 0.5), row)
    with pytest.raises(ValueError, match="2 values"):
        venv.set_attr("mark", [1, 2])
    with pytest.raises(ValueError, match="reset"):
        venv.call("reset")
    with pytest.raises(AttributeError, match="no_such_thing"):
        venv.get_attr("no_such_thing")
    if workers:
        with pytest.raises(Exception, match="pickle"):  # an answer that cannot be sent is no death
            venv.each(give_a_function, [()] * N)
    venv.step(STILL)


def give_a_function(env: Any) -> Any:
    return lambda: env


def set_state(env: gymnasium.Env[Any, Any], state: Any) -> None:
    env.unwrapped.set_state(state)


def test_a_batch_in_windows_returns_nothing_and_needs_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    venv = started(render_mode="human")
    assert venv.step(STILL)[4]["period"].tolist() == [1] * N
    assert (venv.render_mode, venv.render()) == ("human", (None,) * N)
    venv.close()
    monkeypatch.setenv("SDL_VIDEODRIVER", "no_such_driver")
    with pytest.raises(ConfigError, match="'human' can open no window"):
        make_small(render_mode="human")


def test_a_time_limit_is_a_keyword_and_wrappers_are_for_each_environment() -> None:
    venv = make_small(
        max_episode_steps=2, autoreset_mode="SameStep", wrappers=(RecordEpisodeStatistics, FlattenObservation)
    )
    assert gymnasium.vector.VectorEnv in type(venv).__bases__  # skrl looks at the direct bases
    assert venv.reset(seed=1)[0] in venv.observation_space
    venv.step(STILL)
    infos = venv.step(STILL)[4]
    assert infos["final_info"]["episode"]["l"].tolist() == [2] * N
    assert infos["final_obs"][0].shape == venv.single_observation_space.shape


WRONG = {
    "num_envs: '2'": {"count": "2"},
    "workers: 0": {"workers": 0},
    "autoreset_mode: 'sometimes'.*'NextStep'": {"autoreset_mode": "sometimes"},
    "context: 'thread'.*spawn": {"context": "thread"},
}


def test_wrong_arguments_name_the_field_and_the_bound() -> None:
    for message, keywords in WRONG.items():
        with pytest.raises(ValueError, match=message):
            make_small(**keywords)
    with pytest.raises(ConfigError, match="layuot"):  # before a process is started
        gymnasium.make_vec(LAYOUT, 2, layuot="paper")


def test_processes_are_forked_only_where_no_other_thread_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    for platform, threads, method in (("linux", 1, "fork"), ("linux", 2, "forkserver"), ("darwin", 1, "forkserver")):
        monkeypatch.setattr("sys.platform", platform)
        monkeypatch.setattr("threading.active_count", lambda threads=threads: threads)
        assert (start_method(), start_method("spawn")) == (method, "spawn")
