"""Whether the arrays of a decoded state have consistent shapes, and their indices are in bounds.

Compiled functions do not check bounds: an array that is too short would end the process. A declaration is a class name
with a text per array: its dimensions, then optionally the range of its values.

    "mean": "3+2n"             one dimension; a letter is the same number in the whole object
    "rows": "n 4"              two dimensions
    "grid.label": "h w"        an array of an object inside this one
    "outline[]": "n | m 2"     a list of n arrays; m is free for each
    "ids": "n in 0:F"          values from 0 to below F; a capital letter is the same number in the whole state
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from mecp_env.core.carrier import carriers
from mecp_env.core.snapshot import StateError, fields_of
from mecp_env.core.snapshot_check import is_object

Shapes = Mapping[str, Mapping[str, str]]
Sizes = dict[str, int]

FAR = 500  # m; a position further away would need a grid that does not fit into memory
NEAR = f"-{FAR}:{FAR}"
LONG = 1_000_000  # m, rad: anything else that is measured

TERM = re.compile(r"(?:(\d+)\+)?(-?\d*)([a-zA-Z]?)(?:\+(\d+))?")


def check_shapes(value: Any, shapes: Shapes, where: str, sizes: Mapping[str, int]) -> None:
    """Raise `StateError` unless the arrays in `value` are as declared; `sizes` are the capital letters."""
    ShapeCheck(shapes, sizes).check(value, where)


class ShapeCheck:
    """One walk through a graph of objects."""

    def __init__(self, shapes: Shapes, sizes: Mapping[str, int]) -> None:
        self._shapes, self._global, self._seen = shapes, sizes, set[int]()

    def check(self, value: Any, where: str) -> None:
        """Raise `StateError` unless the arrays in `value` are as declared."""
        if id(value) in self._seen:
            return
        self._seen.add(id(value))
        if isinstance(value, np.ndarray):
            check_array(value, where)
        elif is_object(value):
            self._check_object(value, where)
        else:
            for item in items_of(value):
                self.check(item, where)

    def _check_object(self, value: Any, where: str) -> None:
        sizes = dict(self._global)
        for path, text in self._shapes.get(type(value).__name__, {}).items():
            for array, words in arrays_at(value, path, text, sizes, f"{where}.{path}"):
                check_declared(array, words, sizes, f"{where}.{path}")
        frozen = getattr(getattr(value, "__dataclass_params__", None), "frozen", False) or isinstance(value, carriers())
        for name, item in fields_of(value).items():
            if isinstance(item, np.ndarray) and not (frozen or item.flags.writeable):
                raise StateError(f"{where}.{name}: an array that cannot be written to")
            self.check(item, f"{where}.{name}")


def items_of(value: Any) -> Iterator[Any]:
    """What is in a container; nothing of anything else."""
    if isinstance(value, dict):
        yield from value.keys()
        value = list(value.values())
    if isinstance(value, list | tuple | set | frozenset):
        yield from value


def arrays_at(value: Any, path: str, text: str, sizes: Sizes, where: str) -> Iterator[tuple[Any, str]]:
    """The arrays (or whole numbers) that a path leads to, with the declaration of each."""
    for name in path.removesuffix("[]").split("."):
        value = getattr(value, name)
    if value is None:
        return
    if not path.endswith("[]"):
        yield value, text
        return
    length, _, inner = text.rpartition("|")
    if length.strip():
        match_size(length.strip(), len(value), sizes, where)
    items = value.values() if isinstance(value, dict) else value
    yield from ((item, inner) for item in items)


def check_array(array: Any, where: str) -> None:
    """Raise `StateError` for an array that no compiled function was compiled for."""
    if not (array.dtype.isnative and array.flags.c_contiguous and array.flags.aligned):
        raise StateError(f"{where}: an array that is not contiguous, or of another byte order")


def check_declared(value: Any, text: str, sizes: Sizes, where: str) -> None:
    """Raise `StateError` unless an array has the declared dimensions and its values are in their range."""
    dimensions, _, limits = text.partition(" in ")
    words, known = dimensions.split(), sizes_for(dimensions, sizes, where)
    if np.ndim(value) != len(words):
        raise StateError(f"{where}: expected {len(words)} dimensions ({dimensions.strip()}), given {np.shape(value)}")
    for word, size in sorted(zip(words, np.shape(value), strict=True), key=lambda pair: len(pair[0])):
        match_size(word, size, known, where)
    if limits and np.size(value):
        match_range(value, limits, known, where)


def match_range(value: Any, limits: str, sizes: Sizes, where: str) -> None:
    """Raise `StateError` for a value below the first of the limits, or not below the second."""
    low, high = (size_of(word, sizes, where) for word in limits.split(":"))
    if not (np.min(value) >= low and np.max(value) < high):
        raise StateError(f"{where}: expected values from {low} to below {high}")


def sizes_for(dimensions: str, sizes: Sizes, where: str) -> Sizes:
    """The sizes that hold for an array; in a list of arrays each has its own size for the letters it names."""
    if "[]" not in where:
        return sizes
    free = set(re.findall(r"[a-z]", dimensions))
    return {name: size for name, size in sizes.items() if name not in free} if free else sizes


def match_size(word: str, size: int, sizes: Sizes, where: str) -> None:
    """Raise `StateError` unless a dimension has its declared size; a new letter gets this one."""
    if word == "*":
        return
    if len(word) == 1 and word.isalpha():
        sizes.setdefault(word, size)
    if size != size_of(word, sizes, where):
        raise StateError(f"{where}: expected size {word} = {size_of(word, sizes, where)}, given {size}")


def size_of(word: str, sizes: Mapping[str, int], where: str) -> int:
    """The number that `3`, `n`, `2n`, `n+1` or `3+2n` stands for; a letter without a size is 0."""
    found = TERM.fullmatch(word)
    assert found is not None, f"{where}: {word}"
    before, factor, letter, after = found.groups()
    number = int(factor) if factor else 1 if letter else 0
    return int(before or 0) + number * (sizes.get(letter, 0) if letter else 1) + int(after or 0)
