"""Shared memory of a batch: a record of each environment with its observation, mask, result and numbers of its info."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

SEEN, MASK, INFO = "seen", "mask", "info"  # parts of a record
RESULT = ["reward", "terminated", "truncated", "listed"]  # its others; `listed`: the info has all keys of the record
ALONE = ""  # the name of an observation that is no Dict
NUMBERS = (bool, int, float, np.number, np.bool_, np.ndarray)
Bools = NDArray[np.bool_]
Info = dict[str, Any]
Infos = dict[int, Info]  # by number of the environment, or by row: the part of its info that has no place in a record
Add = Callable[[Info, Info, int], Info]  # Gymnasium's own `_add_info`


def record_type(space: spaces.Space[Any], info: Info, masks: int) -> np.dtype[Any]:
    """The record of an environment with that observation space, an `info` like this, and a mask of so many choices."""
    kinds = {name: (box.dtype, box.shape) for name, box in boxes(space).items()}
    given = {name: np.asarray(value) for name, value in info.items() if isinstance(value, NUMBERS)}
    numbers = {name: (value.dtype, value.shape) for name, value in given.items() if value.dtype.kind in "biuf"}
    results = dict(zip(RESULT, "d???", strict=True))
    seen = kinds.get(ALONE) or aligned(kinds)
    return aligned({SEEN: seen, MASK: ("?", (masks,)), **results, INFO: aligned(numbers)})


def boxes(space: spaces.Space[Any]) -> dict[str, spaces.Box]:
    """The parts of an observation space by name. Raises `ValueError` for what is neither Box nor Dict of Box."""
    parts = dict(space.spaces) if isinstance(space, spaces.Dict) else {ALONE: space}
    for name, part in parts.items():
        if not isinstance(part, spaces.Box):
            place = name and f" {name!r}"
            raise ValueError(f"observation space{place}: {part!r:.80}, a batch takes Box, or Dict of Box")
    return parts  # type: ignore[return-value]


def aligned(fields: Mapping[str, Any]) -> np.dtype[Any]:
    """The type with those fields, each where a processor reads it at once."""
    return np.dtype({"names": list(fields), "formats": list(fields.values())}, align=True)


def names_of(values: NDArray[Any]) -> tuple[str, ...]:
    """The names of the fields; none of an array of plain numbers."""
    return values.dtype.names or ()


def observations(records: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """The parts of the observations in records (n,) by name, as views."""
    seen = records[SEEN]
    return {name: seen[name] for name in names_of(seen)} or {ALONE: seen}


def batched_infos(records: NDArray[Any], chosen: Bools, rest: Infos, add: Add) -> Info:
    """The infos of the chosen environments, as Gymnasium batches them: for each key an array, and a mask of its owners.

    The numbers of their records (n,), and the `rest` by row of these; `add` makes arrays with a row for each
    environment of the batch, at least n.
    """
    listed, infos = records["listed"] & chosen, Info()
    for name in names_of(records[INFO]) if listed.any() else ():
        infos[name], infos[f"_{name}"] = records[INFO][name].copy(), listed.copy()
        infos[name][~listed] = 0
    for row, info in rest.items():
        infos = add(infos, info, row)
    return _first_rows(infos, len(records))


def _first_rows(infos: Info, count: int) -> Info:
    return {name: _first_rows(part, count) if isinstance(part, dict) else part[:count] for name, part in infos.items()}
