"""From an action to a velocity command, or an error that changes nothing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from mecp_env.core.errors import ActionError

COMMANDS = ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 0.5), (0.0, -0.5))  # stop, forward, back, left, right
NUMBERS = (int, float, np.integer, np.floating)
ROUNDING = 1e-5  # what a wrapper that rescales actions in float32 may add to a bound


def check_velocity(action: Any) -> tuple[float, float]:
    """The normalised command, two numbers in [-1, 1] that `action` holds.

    Accepts an array (2,) of floats or integers, or a list or tuple of two numbers. A value that rounding moved out of
    range counts as the bound. Raises `ActionError` that names the value and the bound for anything else: nan, infinity,
    another shape or type, a value out of range.
    """
    forward, turn = velocity_pair(action)
    for name, value in (("forward", forward), ("turn", turn)):
        if not abs(value) <= 1.0 + ROUNDING:  # also false for nan
            raise ActionError(f"action[{name}]: {value!r} does not lie in [-1, 1]")
    return within_bounds(forward), within_bounds(turn)


def within_bounds(value: float) -> float:
    """`value`, cut to [-1, 1]."""
    return max(-1.0, min(1.0, value))


def velocity_pair(action: Any) -> tuple[float, float]:
    """`action` as two floats, still unchecked against the bounds."""
    if isinstance(action, np.ndarray):
        if action.shape != (2,) or action.dtype.kind not in "fiu":
            raise ActionError(
                f"action: expected an array of 2 floats in [-1, 1], given shape {action.shape}, dtype {action.dtype}"
            )
        return float(action[0]), float(action[1])
    if not isinstance(action, list | tuple) or len(action) != 2 or not all(is_number(value) for value in action):
        raise ActionError(f"action: expected 2 floats in [-1, 1], given {type(action).__name__} {action!r:.80}")
    return to_float(action[0]), to_float(action[1])


def is_number(value: Any) -> bool:
    """True for an int or a float of Python or NumPy; a bool is none."""
    return isinstance(value, NUMBERS) and not isinstance(value, bool)


def to_float(value: Any) -> float:
    """`value` as a float; an int too large for one becomes infinite, which no bound admits."""
    try:
        return float(value)
    except OverflowError:
        return float("inf") if value > 0 else float("-inf")


def check_choice(action: Any, n: int) -> int:
    """The choice in 0..n-1 that `action` holds.

    Accepts an integer of Python or NumPy, or an integer array without dimensions (what policies return). Raises
    `ActionError` for anything else.
    """
    array = isinstance(action, np.ndarray | np.integer)
    integer = action.shape == () and action.dtype.kind in "iu" if array else type(action) is int
    if not integer:
        raise ActionError(f"action: expected an integer in 0..{n - 1}, given {type(action).__name__} {action!r:.80}")
    if not 0 <= int(action) < n:
        raise ActionError(f"action: {int(action)} does not lie in 0..{n - 1}")
    return int(action)


class Actions(NamedTuple):
    """An action space, and what its actions command."""

    space: spaces.Space[Any]
    command: Callable[[Any], tuple[float, float]]  # forward and turn command in [-1, 1]; raises `ActionError`


def make_actions(kind: str) -> Actions:
    """The actions named `kind`; below `goal` lies `velocity`, which the wrapper `GoalActions` drives.

    `velocity`: fractions of the largest forward speed and of the largest turn rate (counter-clockwise). `discrete`:
    stop, forward, back, left, right (the turns at half of the largest rate).
    """
    if kind == "discrete":
        return Actions(spaces.Discrete(len(COMMANDS)), lambda action: COMMANDS[check_choice(action, len(COMMANDS))])
    return Actions(spaces.Box(-1.0, 1.0, (2,), np.float32), check_velocity)


def normalised_command(v: float, w: float, limits: tuple[float, float]) -> NDArray[np.float32]:
    """The velocity action (2,) for a command of v m/s and w rad/s under `limits` (m/s, rad/s), cut to [-1, 1]."""
    return np.array((within_bounds(v / limits[0]), within_bounds(w / limits[1])), np.float32)
