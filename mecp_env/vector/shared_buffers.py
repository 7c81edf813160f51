"""Shared memory of a batch: one block with an array for each result of a step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

ALIGNMENT = 64  # bytes; a line of the processor's cache
OBSERVATION, INFO = "observation/", "info/"  # prefixes of field names
ALONE = ""  # the name of an observation that is no Dict


@dataclass(frozen=True, slots=True)
class Field:
    """An array of the shared buffers: a row for each environment."""

    shape: tuple[int, ...]
    dtype: str

    @property
    def bytes(self) -> int:
        return int(np.prod(self.shape)) * np.dtype(self.dtype).itemsize


Fields = dict[str, Field]
SharedBuffers = dict[str, NDArray[Any]]


def plan_fields(n: int, space: spaces.Space[Any], info: Mapping[str, Any], masks: int) -> Fields:
    """The fields for `n` environments with an observation space, an `info` as theirs, and masks of so many choices.

    Raises `ValueError` for an observation space that is neither a Box nor a Dict of them.
    """
    rows: dict[str, tuple[tuple[int, ...], Any]] = {
        "reward": ((), np.float64),
        "terminated": ((), np.bool_),
        "truncated": ((), np.bool_),
        "listed": ((), np.bool_),  # whether the row's info has all keys that the buffers hold
        "mask": ((masks,), np.bool_),
    }
    rows |= {OBSERVATION + name: (box.shape, box.dtype) for name, box in boxes(space).items()}
    rows |= {INFO + name: (number.shape, number.dtype) for name, number in numbers(info).items()}
    return {name: Field((n, *shape), np.dtype(dtype).str) for name, (shape, dtype) in rows.items()}


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
        flat = np.frombuffer(memory, field.dtype, int(np.prod(field.shape)), offset) if field.bytes else np.zeros(0)
        buffers[name] = flat.reshape(field.shape).astype(field.dtype, copy=False)
        offset += _padded(field)
    return buffers


def below(buffers: SharedBuffers, prefix: str) -> SharedBuffers:
    """The arrays whose names have the `prefix`, by the rest of their names."""
    return {name.removeprefix(prefix): array for name, array in buffers.items() if name.startswith(prefix)}


def _padded(field: Field) -> int:
    return -(-field.bytes // ALIGNMENT) * ALIGNMENT
