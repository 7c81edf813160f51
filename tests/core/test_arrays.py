"""Look-ups in arrays of ids."""

import numpy as np

from mecp_env.core.arrays import find_rows, rows_by_id


def test_rows_are_found_by_id() -> None:
    ids, asked = np.array([7, -3, 2, 40]), np.array([[2, 9], [7, 0]])
    rows = rows_by_id(ids, asked)
    assert len(rows) == 10
    assert rows[asked].tolist() == [[2, -1], [0, -1]]
    found = np.empty(4, np.int64)
    assert not find_rows(ids, asked.ravel(), found)
    assert found.tolist() == rows[asked].ravel().tolist()
