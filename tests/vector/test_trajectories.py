"""As Gymnasium's own class, bit for bit: of any environment, and of ours in any number of workers, however started."""

from functools import partial
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from mecp_env.vector import BatchEnv
from mecp_env.vector import batch as batching
from tests.env.helpers import SMALL, same
from tests.vector.helpers import LAYOUT, PEOPLE, ROOMS, N, choose

STEPS = 12  # an episode ends, and the next one goes on


def take(venv: Any, mode: AutoresetMode = AutoresetMode.NEXT_STEP) -> list[Any]:
    """What a reset and some steps give; where the mode resets nothing, also resets of what is over."""
    rng = np.random.default_rng(0)
    rows = [venv.reset(seed=3)]
    for _ in range(STEPS):
        rows.append(venv.step(choose(venv.single_action_space, rows[-1][0], rng)))
        over = rows[-1][2] | rows[-1][3]
        if mode == AutoresetMode.DISABLED and over.any():
            rows.append(venv.reset(options={"reset_mask": over}))
    venv.close()
    assert any(row[2].any() or row[3].any() for row in rows if len(row) == 5)
    return rows


class Counter(gymnasium.Env[Any, Any]):
    """Counts to its end; its info has numbers, an array, a text, a list, and at times a key more."""

    def __init__(self, alone: bool) -> None:
        pose = spaces.Box(-9.0, 9.0, (3,), np.float32)
        grid = spaces.Box(0, 255, (2, 4), np.uint8)
        self.alone = alone
        self.observation_space = pose if alone else spaces.Dict({"pose": pose, "grid": grid})
        self.action_space = spaces.Discrete(5) if alone else spaces.Box(-1.0, 1.0, (2,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.x, self.count, self.end = self.np_random.normal(size=3), 0, int(self.np_random.integers(2, 6))
        return self.seen(), self.info()

    def step(self, action: Any) -> Any:
        self.count += 1
        self.x = np.clip(self.x + 0.1 * np.sum(action), -9.0, 9.0)
        return self.seen(), float(self.x.sum()), self.count == self.end, self.count == 5, self.info()

    def seen(self) -> Any:
        pose = self.x.astype(np.float32)
        return pose if self.alone else {"pose": pose, "grid": np.full((2, 4), self.count, np.uint8)}

    def info(self) -> dict[str, Any]:
        numbers = {"count": self.count, "share": self.count / 7, "odd": bool(self.count % 2), "x": self.x.copy()}
        more = {"more": self.count} if self.count % 3 == 2 else {}
        return numbers | {"event": f"event {self.count}", "list": [1, 2]} | more


@pytest.mark.parametrize(("workers", "cores"), [(2, 1), (None, 1), (None, 2)], ids=["workers", "here", "both"])
@pytest.mark.parametrize("alone", [False, True])
@pytest.mark.parametrize("mode", AutoresetMode)
def test_any_environment(
    mode: AutoresetMode, alone: bool, workers: int | None, cores: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Observations of any form, and every key of the infos."""
    monkeypatch.setattr(batching, "load", lambda: None)  # nothing here is compiled
    monkeypatch.setattr(batching, "cores", lambda: cores)
    makers = [partial(Counter, alone)] * 4
    batch = BatchEnv(makers, workers=workers, autoreset_mode=mode, context="fork")
    assert batch.autoreset_mode == batch.metadata["autoreset_mode"] == mode  # for TorchRL, and for wrappers
    assert same(take(batch, mode), take(SyncVectorEnv(makers, autoreset_mode=mode), mode))


BUILDINGS: dict[str, Any] = {"difficulty": "easy", "laser": SMALL["laser"]}
KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "velocity": (LAYOUT, SMALL | {"max_steps": 6}),
    "discrete": (LAYOUT, SMALL | {"actions": "discrete", "max_steps": 6}),
    "goal": (LAYOUT, SMALL | {"actions": "goal", "max_steps": 30}),
    "buildings": (ROOMS, BUILDINGS | PEOPLE | {"max_steps": 6}),
    "goals in buildings": (ROOMS, BUILDINGS | PEOPLE | {"actions": "goal", "max_steps": 30}),
}
PROCESSES = [*((kind, "fork", 2) for kind in KINDS), ("velocity", "fork", 1), ("velocity", "fork", 3)]
SLOW_STARTS = [pytest.param("velocity", context, 2, marks=pytest.mark.slow) for context in ("forkserver", "spawn")]


@pytest.mark.parametrize(("kind", "context", "workers"), [*PROCESSES, *SLOW_STARTS])
def test_ours_in_processes(kind: str, context: str, workers: int) -> None:
    name, keywords = KINDS[kind]
    batch = gymnasium.make_vec(name, N, workers=workers, context=context, **keywords)
    assert len(batch.pids) == workers
    assert same(take(batch), take(gymnasium.make_vec(name, N, vectorization_mode="sync", **keywords)))
