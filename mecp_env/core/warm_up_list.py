"""The list of functions that an episode calls from Python, with their argument types, and types as plain data.

It is only a hint: a function that is missing in it, or whose types changed, is compiled when it is called.
`python -m mecp_env.cli.record_signatures` writes it again.
"""

from __future__ import annotations

import functools
import importlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba import types

LIST = Path(__file__).with_name("signatures.json")

Entry = list[Any]  # module, name, encoded argument types


@functools.cache
def entries() -> list[Entry]:
    """The list; empty where the file is missing or damaged."""
    try:
        found: list[Entry] = json.loads(LIST.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    return found


@functools.cache
def _names() -> frozenset[str]:
    return frozenset(f"{module}.{name}" for module, name, _ in entries())


def called_from_python(function: Callable[..., Any]) -> bool:
    """True when the list names the function."""
    return f"{function.__module__}.{function.__name__}" in _names()


def function_of(entry: Entry) -> Any:
    """The compiled function of an entry. Raises `ImportError` or `AttributeError` for one that was renamed."""
    return getattr(importlib.import_module(entry[0]), entry[1])


def encode(argument: types.Type) -> Any:
    """An argument's type as plain data. Raises `ValueError` for kinds that no function takes."""
    if isinstance(argument, types.Array):
        layout = (argument.ndim, argument.layout, argument.mutable, argument.aligned)
        return ["array", _encode_items(argument.dtype), *layout]
    if isinstance(argument, types.BaseNamedTuple):
        kind = argument.instance_class
        return ["named", kind.__module__, kind.__qualname__, [encode(part) for part in argument.types]]
    if isinstance(argument, types.BaseTuple):
        return ["tuple", [encode(part) for part in argument.types]]
    if isinstance(argument, types.Number | types.Boolean):
        return str(argument)
    raise ValueError(f"no function takes {argument}")


def _encode_items(dtype: types.Type) -> Any:
    """The element type of an array; a structured one as names, types and offsets."""
    if not isinstance(dtype, types.Record):
        return str(dtype)
    fields = [(name, *_encode_field(field.type), field.offset) for name, field in dtype.fields.items()]
    return [fields, dtype.size, dtype.aligned]


def _encode_field(kind: types.Type) -> tuple[str, list[int]]:
    """The element type and the shape of a field; () for a number."""
    return (str(kind.dtype), list(kind.shape)) if isinstance(kind, types.NestedArray) else (str(kind), [])


def decode(data: Any) -> types.Type:
    """The type that `encode` made `data` of."""
    if isinstance(data, str):
        return numba.from_dtype(np.dtype(data))
    kind, *parts = data
    if kind == "array":
        dtype, ndim, layout, mutable, aligned = parts
        return types.Array(_decode_items(dtype), ndim, layout, readonly=not mutable, aligned=aligned)
    if kind == "named":
        module, name, inner = parts
        return types.NamedTuple([decode(part) for part in inner], getattr(importlib.import_module(module), name))
    return types.Tuple([decode(part) for part in parts[0]])


def _decode_items(data: Any) -> types.Type:
    if isinstance(data, str):
        return numba.from_dtype(np.dtype(data))
    fields, size, aligned = data
    names, formats, shapes, offsets = zip(*fields, strict=True)
    kinds = [(kind, tuple(shape)) for kind, shape in zip(formats, shapes, strict=True)]
    words: Any = {"names": list(names), "formats": kinds, "offsets": list(offsets), "itemsize": size}
    return numba.from_dtype(np.dtype(words, align=aligned))
