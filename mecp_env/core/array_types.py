"""Names of array types. Shape, unit and frame are in the comment or docstring beside each array."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
Rows = NDArray[np.void]  # structured: numbers by name
