"""Shared memory of a batch: arrays of observations and masks, and a record of each environment with all its numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

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
