"""What a user gives to a batch, checked: seeds, options of a reset, the autoreset mode, counts, numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from mecp_env.core.errors import ConfigError
from mecp_env.episode.start import check_seed

Seeds = int | Sequence[int | None] | None
MASK = "reset_mask"


def check_mode(mode: str | AutoresetMode) -> AutoresetMode:
    """The autoreset mode of that name. Raises `ValueError`."""
    try:
        return AutoresetMode(mode)
    except ValueError:
        names = ", ".join(repr(known.value) for known in AutoresetMode)
        raise ValueError(f"autoreset_mode: {mode!r}, expected one of {names}") from None


def check_integer(name: str, value: Any, most: int | None = None, otherwise: str = "") -> int:
    """`value` itself. Raises `ValueError` unless it is an integer from 1 to `most`."""
    if not _is_integer(value) or value < 1 or (most is not None and value > most):
        bounds = "of at least 1" if most is None else f"from 1 to {most}"
        raise ValueError(f"{name}: {value!r:.80}, expected an integer {bounds}{otherwise}")
    return int(value)


def check_ids(ids: Any, count: int) -> NDArray[np.intp]:
    """The numbers of environments (n,). Raises `ValueError` for what is no number, out of range, or given twice."""
    numbers = np.arange(count) if ids is None else np.asarray(ids)
    numbered = numbers.ndim == 1 and numbers.size > 0 and np.issubdtype(numbers.dtype, np.integer)
    if not numbered or not np.isin(numbers, range(count)).all() or len(np.unique(numbers)) < len(numbers):
        raise ValueError(f"env_ids: {ids!r:.80}, expected different numbers of environments from 0 to {count - 1}")
    return numbers.astype(np.intp)


def check_count(actions: Any, count: int, whose: str) -> None:
    """Raise `ValueError` unless there is an action for each of `count`, in a list, a tuple or an array."""
    several = isinstance(actions, Sequence) or getattr(actions, "ndim", 0) > 0
    if not several or len(actions) != count:
        given = f"{len(actions)} of them" if several else f"{actions!r:.80}"
        raise ValueError(f"actions: {given}, expected one for each of {count} {whose}")


def check_seeds(seed: Seeds, count: int) -> list[int | None]:
    """A seed for each environment: `seed + i` of a number, the entries of a list. Raises `ConfigError`."""
    try:
        if isinstance(seed, Sequence | np.ndarray) and len(seed) == count:
            return [check_seed(entry) for entry in seed]
        first = check_seed(seed)
    except ConfigError as error:
        raise ConfigError(f"{error}, or one for each of {count} environments") from None
    return [None if first is None else first + i for i in range(count)]


def _is_integer(value: Any) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def check_options(options: dict[str, Any] | None, count: int) -> tuple[dict[str, Any] | None, NDArray[np.bool_]]:
    """The options for each environment, and which environments to reset (N,). Raises `TypeError`, `ValueError`."""
    if options is None or MASK not in options:
        return options, np.ones(count, np.bool_)
    mask = _checked_mask(options[MASK], count)
    return {name: value for name, value in options.items() if name != MASK} or None, mask.copy()


def _checked_mask(mask: Any, count: int) -> NDArray[np.bool_]:
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
        raise TypeError(f"options[{MASK!r}]: {mask!r:.80}, expected a NumPy array of bool")
    if mask.shape != (count,) or not mask.any():
        raise ValueError(f"options[{MASK!r}]: {mask!r:.80}, expected shape ({count},) and at least one True")
    return mask
