"""A batch of environments of any kind is as Gymnasium's own class: observations, results, every key of infos."""

from functools import partial
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from mecp_env.vector import BatchEnv
from mecp_env.vector import batch as batching
from tests.env.helpers import same

COUNT, STEPS = 4, 12


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


def take(venv: Any, mode: AutoresetMode) -> list[Any]:
    """What a reset and some steps give; where the mode resets nothing, also resets of what is over."""
    rng, space = np.random.default_rng(0), venv.single_action_space
    rows = [venv.reset(seed=3)]
    for _ in range(STEPS):
        drawn = rng.uniform(-1.0, 1.0, (COUNT, 2)).astype(np.float32), rng.integers(0, 5, COUNT)
        rows.append(venv.step(drawn[isinstance(space, spaces.Discrete)]))
        over = rows[-1][2] | rows[-1][3]
        if mode == AutoresetMode.DISABLED and over.any():
            rows.append(venv.reset(options={"reset_mask": over}))
    venv.close()
    return rows


@pytest.mark.parametrize(("workers", "cores"), [(2, 1), (None, 1), (None, 2)], ids=["workers", "here", "both"])
@pytest.mark.parametrize("alone", [False, True])
@pytest.mark.parametrize("mode", AutoresetMode)
def test_a_batch_gives_what_gymnasiums_own_class_gives(
    mode: AutoresetMode, alone: bool, workers: int | None, cores: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batching, "load", lambda: None)  # nothing here is compiled
    monkeypatch.setattr(batching, "cores", lambda: cores)
    makers = [partial(Counter, alone)] * COUNT
    batch = BatchEnv(makers, workers=workers, autoreset_mode=mode, context="fork")
    assert same(take(batch, mode), take(SyncVectorEnv(makers, autoreset_mode=mode), mode))
