"""What the stages pass to each other: names of array types, and the classes that carry arrays, forty in a control step.

Shape, unit and frame are in the comment or docstring beside each array.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeVar, dataclass_transform

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
Rows = NDArray[np.void]  # structured: numbers by name
Record = Any  # one of these rows, as compiled functions read it


def row_type(fields: Sequence[tuple[Any, ...]]) -> np.dtype[np.void]:
    """The type of `Rows` with these fields, as `np.dtype` takes them.

    Compiled functions read a field of a row by its name. Python does so where nothing is compiled; elsewhere a call
    with such rows would take .2 us more.
    """
    from numba import config  # not where types are only named

    plain = np.dtype(list(fields), align=True)
    return np.dtype((np.record, plain)) if config.DISABLE_JIT else plain


T = TypeVar("T")
_made = list[type]()


@dataclass_transform(eq_default=False, frozen_default=True)
def carrier(cls: type[T]) -> type[T]:
    """A dataclass with slots, to which the type checker lets nobody assign (a frozen one takes 2 us more)."""
    made = dataclass(slots=True, eq=False)(cls)
    _made.append(made)
    return made


def carriers() -> tuple[type, ...]:
    """All classes of carriers: an array in one may be read-only."""
    return tuple(_made)
