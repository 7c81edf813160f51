"""When an estimate counts as lost."""

import math

import numpy as np
import pytest

from mecp_env.evaluation.metric_arrays import LOST_STEPS, LostWatch

RIGHT = np.zeros(60)


def off(first: int, count: int, error: float) -> np.ndarray:
    """An error (60,) in some steps."""
    errors = np.zeros(60)
    errors[first : first + count] = error
    return errors


def is_lost(error_m: np.ndarray, error_rad: np.ndarray, diverged: bool) -> bool:
    """After all steps."""
    watch = LostWatch()
    for step in zip(error_m.tolist(), error_rad.tolist(), strict=True):
        watch.look(*step)
    return watch.is_lost(diverged)


def by_windows(error_m: np.ndarray, error_rad: np.ndarray) -> bool:
    """The same, of all steps at once."""
    off = (error_m > 1.0) | (abs(error_rad) > math.radians(10.0))
    return bool(off[-1]) or any(off[i : i + LOST_STEPS].all() for i in range(len(off) - LOST_STEPS + 1))


def test_twenty_steps_in_a_row_in_position_or_heading_the_end_and_divergence_are_lost() -> None:
    assert LOST_STEPS == 20
    assert is_lost(off(10, 20, 1.01), RIGHT, False)
    assert not is_lost(off(10, 19, 1.01), RIGHT, False)
    for sign in (1.0, -1.0):
        assert is_lost(RIGHT, off(10, 20, sign * math.radians(10.1)), False)
        assert not is_lost(RIGHT, off(10, 20, sign * math.radians(9.9)), False)
    assert is_lost(off(59, 1, 1.5), RIGHT, False)
    assert is_lost(RIGHT, RIGHT, True)


@pytest.mark.parametrize("seed", range(5))
def test_the_watch_of_an_episode_gives_the_same_at_every_step(seed: int) -> None:
    rng, watch = np.random.default_rng(seed), LostWatch()
    error_m, error_rad = 2.0 * (rng.random(200) < 0.93), 0.3 * (rng.random(200) < 0.3)
    for step in range(200):
        watch.look(error_m[step], error_rad[step])
        assert watch.is_lost(False) == by_windows(error_m[: step + 1], error_rad[: step + 1])
        assert watch.is_lost(True)
