"""Names of array types. Shape, unit and frame are in the comment or docstring beside each array."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
Rows = NDArray[np.void]  # structured: numbers by name


def row_type(fields: Sequence[tuple[Any, ...]]) -> np.dtype[np.void]:
    """The type of `Rows` with these fields, as `np.dtype` takes them.

    Compiled functions read a field of a row by its name. Python does so where nothing is compiled; elsewhere a call
    with such rows would take .2 us more.
    """
    from numba import config  # not where types are only named

    plain = np.dtype(list(fields), align=True)
    return np.dtype((np.record, plain)) if config.DISABLE_JIT else plain
