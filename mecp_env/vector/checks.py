"""What a user gives to a batch, checked: seeds, options of a reset, the autoreset mode, counts, copies."""

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
    expected = f"expected different numbers of environments from 0 to {count - 1}"
    if numbers.ndim != 1 or not numbers.size or not np.issubdtype(numbers.dtype, np.integer):
        raise ValueError(f"env_ids: {ids!r:.80}, {expected}")
    if numbers.min() < 0 or numbers.max() >= count or len(np.unique(numbers)) < len(numbers):
        raise ValueError(f"env_ids: {numbers.tolist()!r:.80}, {expected}")
    return numbers.astype(np.intp)


def check_copy(copy: bool) -> bool:
    """`copy` itself. Raises `ValueError` unless it is a boolean; the text "no" is not one."""
    if not isinstance(copy, bool | np.bool_):
        raise ValueError(f"copy: {copy!r:.80}, expected True or False")
    return bool(copy)


def check_seeds(seed: Seeds, count: int) -> list[int | None]:
    """A seed for each environment: `seed + i` of a number, the entries of a list. Raises `ValueError`."""
    expected = f"expected an integer, or one for each of {count} environments"
    if seed is None or _is_integer(seed):
        first = _checked_seed(seed, expected)
        return [None if first is None else first + i for i in range(count)]
    if not isinstance(seed, Sequence | np.ndarray):
        raise ValueError(f"seed: {seed!r:.80}, {expected}")
    if len(seed) != count:
        raise ValueError(f"seed: {len(seed)} of them, {expected}")
    return [_checked_seed(entry, expected) for entry in seed]


def _checked_seed(entry: Any, expected: str) -> int | None:
    try:
        return check_seed(entry)
    except ConfigError as error:
        raise ConfigError(f"{error}; {expected}") from None


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
        kind = f"an array of {mask.dtype}" if isinstance(mask, np.ndarray) else type(mask).__name__
        raise TypeError(f"options[{MASK!r}]: {kind}, expected a NumPy array of bool")
    if mask.shape != (count,) or not mask.any():
        raise ValueError(f"options[{MASK!r}]: {mask!r:.80}, expected shape ({count},) and at least one True")
    return mask
