"""Stable-Baselines3: its own vector classes and the batch as one of them give the same, masks of goals included."""

from functools import partial
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import TimeLimit

from tests.env.helpers import SMALL, make, same
from tests.vector.helpers import LAYOUT, N, choose, make_small

vec_env = pytest.importorskip("stable_baselines3.common.vec_env")
utils = pytest.importorskip("sb3_contrib.common.maskable.utils")
sb3_batch = pytest.importorskip("mecp_env.learning.sb3_batch")

STEPS = 12
KINDS = {"velocity": {"max_steps": 5}, "goal": {"actions": "goal", "max_steps": 30}}


def make_batch(**keywords: Any) -> Any:
    return sb3_batch.make(LAYOUT, N, context="fork", workers=2, **(SMALL | keywords))


def take(venv: Any) -> list[Any]:
    """All results of a VecEnv on a drive, with masks."""
    rng = np.random.default_rng(0)
    venv.seed(3)
    rows: list[Any] = [(dict(venv.reset()), list(venv.reset_infos))]
    for _ in range(STEPS):
        masks = utils.get_action_masks(venv) if utils.is_masking_supported(venv) else None
        assert masks is None or np.array_equal(masks, rows[-1][0]["goals"][:, :, 8] == 1.0)
        observation, rewards, dones, infos = venv.step(choose(venv.action_space, rows[-1][0], rng))
        rows.append((dict(observation), rewards.astype(np.float32), dones, list(infos), list(venv.reset_infos), masks))
    return rows


@pytest.mark.parametrize("actions", KINDS)
def test_the_batch_gives_what_their_own_class_gives(actions: str) -> None:
    ours = make_batch(**KINDS[actions])
    other = vec_env.DummyVecEnv([lambda: make(**KINDS[actions])] * N)
    given, expected = take(ours), take(other)
    assert any(row[2].any() for row in given[1:])
    assert (given[-1][-1] is not None) == (actions == "goal")
    for mine, yours in zip(given, expected, strict=True):
        assert same(plain(mine), plain(yours))


def plain(value: Any) -> Any:
    """Without the difference between numbers of Python and of NumPy in infos."""
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    return value.item() if isinstance(value, np.generic) else value


def test_methods_and_attributes_of_some_or_all_environments() -> None:
    venv = make_batch(wrappers=(partial(TimeLimit, max_episode_steps=2),), render_mode="rgb_array")
    venv.set_options({"start": "random"})
    venv.reset()
    assert venv.env_is_wrapped(TimeLimit) == [True] * N
    assert venv.env_is_wrapped(gymnasium.wrappers.FlattenObservation, indices=1) == [False]
    assert not utils.is_masking_supported(venv)
    venv.set_attr("mark", 5, indices=[0, 2])
    venv.set_attr("mark", 6, indices=1)
    assert venv.get_attr("mark") == [5, 6, 5]
    assert [summary["periods"] for summary in venv.env_method("summary", indices=[0, 1])] == [0, 0]
    assert [image.dtype for image in venv.get_images()] == [np.uint8] * N
    assert venv.metadata["render_fps"] == venv.get_attr("metadata")[0]["render_fps"] == 10
    venv.close()
    venv.close()


def test_another_autoreset_mode_and_different_options_are_refused() -> None:
    batch = make_small()
    with pytest.raises(ValueError, match="SameStep"):
        sb3_batch.SB3Batch(batch)
    venv = make_batch()
    venv.set_options([{"start": "random"}, {}, {}])
    with pytest.raises(ValueError, match="same options"):
        venv.reset()
