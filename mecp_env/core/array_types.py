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
    """The type of `Rows` with these fields, as `np.dtype` takes them; a row has them as attributes in Python, too."""
    return np.dtype((np.record, np.dtype(list(fields), align=True)))
