"""Infos of many environments as Gymnasium batches them: for each key an array, and a mask of who has the key."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mecp_env.vector.shared_buffers import INFO, info_names
from mecp_env.vector.worker import Info, Infos

Add = Callable[[Info, Info, int], Info]  # Gymnasium's own `_add_info`


def batched_infos(records: NDArray[Any], chosen: NDArray[np.bool_], rest: Infos, add: Add) -> Info:
    """The infos of the chosen environments: the numbers of their records (n,), which are overwritten, and the rest.

    `rest` is by row of the records; `add` makes arrays with a row for each environment of the batch, at least n.
    """
    infos = _of_records(records, records["listed"] & chosen)
    others = {row: left for row, info in rest.items() if (left := _without_texts(infos, info, row, len(records)))}
    for row, info in others.items():
        infos = add(infos, info, row)
    return _first_rows(infos, len(records)) if others else infos


def _first_rows(infos: Info, count: int) -> Info:
    return {name: _first_rows(part, count) if isinstance(part, dict) else part[:count] for name, part in infos.items()}


def _of_records(records: NDArray[Any], listed: NDArray[np.bool_]) -> Info:
    """The numbers of the listed environments; where these are all, one mask is that of every key."""
    if not listed.any():
        return {}
    complete = bool(listed.all())
    if not complete:
        records[~listed] = 0
    columns, masks = _columns(records.dtype)
    infos: Info = {name: records[field] for name, field in columns}
    return infos | (dict.fromkeys(masks, listed) if complete else {mask: listed.copy() for mask in masks})


@cache
def _columns(record: np.dtype[Any]) -> tuple[list[tuple[str, str]], list[str]]:
    """The keys of an info that records hold: each with the name of its field; and the keys of their masks."""
    names = info_names(record)
    return [(name, INFO + name) for name in names], [f"_{name}" for name in names]


def _without_texts(infos: Info, info: Info, row: int, count: int) -> Info:
    """Add the texts of an info, which each step has, as Gymnasium would; the others of its entries."""
    others = {}
    for name, value in info.items():
        if type(value) is not str:
            others[name] = value
            continue
        if name not in infos:
            infos[name], infos[f"_{name}"] = np.full(count, None, object), np.zeros(count, np.bool_)
        infos[name][row], infos[f"_{name}"][row] = value, True
    return others
