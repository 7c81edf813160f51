"""Shared memory of a batch: observations, masks, a record of numbers; and its infos as Gymnasium batches them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from mecp_env.vector.worker import Info, Infos

ALIGNMENT = 64  # bytes; a line of the processor's cache
OBSERVATION, INFO = "observation/", "info/"  # prefixes of the names of fields, and of the numbers in a record
MASK, RECORD = "mask", "record"
RESULT = ("reward", "terminated", "truncated", "listed")  # first in a record; `listed`: its info has all keys
ALONE = ""  # the name of an observation that is no Dict


@dataclass(frozen=True, slots=True)
class Field:
    """An array of the shared buffers: a row for each environment."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    @property
    def bytes(self) -> int:
        return int(np.prod(self.shape)) * self.dtype.itemsize


Fields = dict[str, Field]
SharedBuffers = dict[str, NDArray[Any]]


def plan_fields(n: int, space: spaces.Space[Any], info: Mapping[str, Any], masks: int) -> Fields:
    """The fields for `n` environments with an observation space, an `info` as theirs, and masks of so many choices.

    Raises `ValueError` for an observation space that is neither a Box nor a Dict of them.
    """
    rows: dict[str, tuple[tuple[int, ...], np.dtype[Any]]]
    rows = {OBSERVATION + name: (box.shape, np.dtype(box.dtype)) for name, box in boxes(space).items()}
    rows |= {MASK: ((masks,), np.dtype(np.bool_)), RECORD: ((), record_type(info))}
    return {name: Field((n, *shape), dtype) for name, (shape, dtype) in rows.items()}


def record_type(info: Mapping[str, Any]) -> np.dtype[Any]:
    """The numbers of one environment, side by side: reward, ends, and the numbers of its info."""
    kinds: list[Any] = list(zip(RESULT, ("f8", "?", "?", "?"), strict=True))
    kinds += [(INFO + name, number.dtype, number.shape) for name, number in numbers(info).items()]
    return np.dtype(kinds, align=True)


def info_names(record: np.dtype[Any]) -> list[str]:
    """The keys of an info that a record holds."""
    return [name.removeprefix(INFO) for name in record.names or () if name.startswith(INFO)]


def boxes(space: spaces.Space[Any]) -> dict[str, spaces.Box]:
    """The parts of an observation space by name. Raises `ValueError` for what is neither Box nor Dict of Box."""
    parts = dict(space.spaces) if isinstance(space, spaces.Dict) else {ALONE: space}
    for name, part in parts.items():
        if not isinstance(part, spaces.Box):
            raise ValueError(
                f"observation space{name and f' {name!r}'}: {part!r:.80}, a batch takes Box, or Dict of Box"
            )
    return parts  # type: ignore[return-value]


def numbers(info: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """The entries of an info that are numbers, or arrays of numbers; the others travel by message."""
    kinds = (bool, int, float, np.number, np.bool_, np.ndarray)
    given = {name: np.asarray(value) for name, value in info.items() if isinstance(value, kinds)}
    return {name: value for name, value in given.items() if value.dtype.kind in "biuf"}


def memory_bytes(fields: Fields) -> int:
    """How much memory the fields need."""
    return sum(_padded(field) for field in fields.values())


def lay_out(fields: Fields, memory: Any) -> SharedBuffers:
    """The arrays of the fields in a block of memory, the same in every process."""
    buffers, offset = {}, 0
    for name, field in fields.items():
        count = int(np.prod(field.shape))
        flat = np.frombuffer(memory, field.dtype, count, offset) if count else np.zeros(0, field.dtype)
        buffers[name] = flat.reshape(field.shape)
        offset += _padded(field)
    return buffers


def below(buffers: SharedBuffers, prefix: str) -> SharedBuffers:
    """The arrays whose names have the `prefix`, by the rest of their names."""
    return {name.removeprefix(prefix): array for name, array in buffers.items() if name.startswith(prefix)}


def copied(records: NDArray[Any]) -> NDArray[Any]:
    """A copy of records (n,) as a whole; NumPy copies them field by field."""
    return records.view(np.uint8).copy().view(records.dtype)


def _padded(field: Field) -> int:
    return -(-field.bytes // ALIGNMENT) * ALIGNMENT


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
