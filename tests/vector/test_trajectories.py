"""The same trajectories, bit for bit: in this process, and in batches of any number of workers, however started."""

from contextlib import closing
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
PROCESSES = [*((kind, "fork", 2) for kind in KINDS), ("velocity", "fork", 1), ("velocity", "fork", 3)]
SLOW_STARTS = [pytest.param("velocity", context, 2, marks=pytest.mark.slow) for context in ("forkserver", "spawn")]


def take(venv: Any) -> list[Any]:
    """All results of a vector environment on a drive."""
    rng = np.random.default_rng(0)
    rows = [venv.reset(seed=11)]
    for _ in range(STEPS):
        rows.append(venv.step(choose(venv.single_action_space, rows[-1][0], rng)))
    return rows


@pytest.mark.parametrize(("kind", "context", "workers"), [*PROCESSES, *SLOW_STARTS])
def test_each_environment_goes_as_it_would_in_this_process(kind: str, context: str, workers: int) -> None:
    name, keywords = KINDS[kind]
    alone = gymnasium.make_vec(name, N, vectorization_mode="sync", **keywords)
    with closing(gymnasium.make_vec(name, N, workers=workers, context=context, **keywords)) as venv:
        assert len(venv.pids) == workers
        rows = take(venv)
    assert same(rows, take(alone))
    assert any(row[2].any() or row[3].any() for row in rows[1:])  # episodes end on the way
