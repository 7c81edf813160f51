"""The same trajectories, bit for bit: single environments, batches of any number of workers, however started."""

from contextlib import closing
from functools import cache
from typing import Any

import gymnasium
import numpy as np
import pytest

from tests.env.helpers import SMALL, same
from tests.vector.helpers import LAYOUT, PEOPLE, ROOMS, N, choose

BUILDINGS: dict[str, Any] = {"difficulty": "easy", "laser": SMALL["laser"]}
KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "velocity": (LAYOUT, SMALL | {"max_steps": 6}),
    "discrete": (LAYOUT, SMALL | {"actions": "discrete", "max_steps": 6}),
    "goal": (LAYOUT, SMALL | {"actions": "goal", "max_steps": 30}),
    "buildings": (ROOMS, BUILDINGS | PEOPLE | {"max_steps": 6}),
    "goals in buildings": (ROOMS, BUILDINGS | PEOPLE | {"actions": "goal", "max_steps": 30}),
}
STEPS = 10  # an episode ends, and the next one goes on


def take(venv: Any) -> list[Any]:
    """All results of a vector environment on a drive."""
    rng = np.random.default_rng(0)
    rows = [venv.reset(seed=11)]
    for _ in range(STEPS):
        rows.append(venv.step(choose(venv.single_action_space, rows[-1][0], rng)))
    return rows


@cache
def take_forked() -> list[Any]:
    """The drive of `take` by a batch of two forked workers."""
    name, keywords = KINDS["velocity"]
    with closing(gymnasium.make_vec(name, N, workers=2, context="fork", **keywords)) as venv:
        return take(venv)


def take_alone(kind: str) -> list[list[tuple[Any, ...]]]:
    """The drive of `take` by single environments: for each row, what each gave."""
    name, keywords = KINDS[kind]
    envs = [gymnasium.make(name, disable_env_checker=True, **keywords) for _ in range(N)]
    rng = np.random.default_rng(0)
    rows = [[env.reset(seed=11 + i) for i, env in enumerate(envs)]]
    over = [False] * N
    for _ in range(STEPS):
        seen = {key: np.stack([row[0][key] for row in rows[-1]]) for key in ("pose", "goals")}
        actions = choose(envs[0].action_space, seen, rng)
        rows.append([advance(envs[i], actions[i], over[i]) for i in range(N)])
        over = [row[2] or row[3] for row in rows[-1]]
    return rows


def advance(env: gymnasium.Env[Any, Any], action: Any, over: bool) -> tuple[Any, ...]:
    if over:
        observation, info = env.reset()
        return observation, 0.0, False, False, info
    return env.step(action)


@pytest.mark.parametrize("kind", KINDS)
def test_each_environment_goes_as_it_would_alone(kind: str) -> None:
    name, keywords = KINDS[kind]
    with closing(gymnasium.make_vec(name, N, workers=2, context="fork", **keywords)) as venv:
        together, alone = take(venv), take_alone(kind)
    assert len(together) == len(alone)
    assert any(row[2].any() or row[3].any() for row in together[1:])  # episodes end on the way
    for row, singles in zip(together, alone, strict=True):
        for i, single in enumerate(singles):
            assert all(same(row[0][key][i], single[0][key]) for key in single[0])
            assert [part[i] for part in row[1:-1]] == list(single[1:-1])
            assert all(np.array_equal(row[-1][key][i], value) for key, value in single[-1].items())
            assert all(row[-1][f"_{key}"][i] for key in single[-1])


SLOW_STARTS = [pytest.param(context, 2, marks=pytest.mark.slow) for context in ("forkserver", "spawn")]


@pytest.mark.parametrize(("context", "workers"), [("fork", 1), ("fork", 3), *SLOW_STARTS])
def test_neither_how_processes_are_started_nor_what_each_steps_changes_anything(context: str, workers: int) -> None:
    name, keywords = KINDS["velocity"]
    with closing(gymnasium.make_vec(name, N, workers=workers, context=context, **keywords)) as venv:
        assert len(venv.pids) == workers
        assert same(take(venv), take_forked())
