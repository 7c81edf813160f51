"""Whether what a state was decoded to is what its classes declare: every field there, none beside, each of its type.

Whether the arrays of a decoded state have consistent shapes, and their indices are in bounds.

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
import types
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from mecp_env.core.carriers import carriers
from mecp_env.core.settings import Settings
from mecp_env.core.snapshot import PACKAGE, PLAIN, StateError, fields_of

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
            for item in contents_of(value):
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


def contents_of(value: Any) -> Iterator[Any]:
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


Examples = Mapping[type, Mapping[str, Any]]

MOST = 2**62  # of whole numbers: compiled functions have 64 bits


def examples_of(value: Any) -> Examples:
    """Of every object in `value` that is no dataclass: the class, and its fields with the types declared or found."""
    found: dict[type, Mapping[str, Any]] = {}
    for item in filter(is_object, fields_of(value).values()):
        found.update(examples_of(item))
        if not is_dataclass(item):
            declared = get_type_hints(type(item))
            found[type(item)] = {name: declared.get(name, kind_of(part)) for name, part in fields_of(item).items()}
    return found


def kind_of(value: Any) -> Any:
    """The type of a field; of an array with that of its elements."""
    return np.ndarray[Any, np.dtype[value.dtype.type]] if isinstance(value, np.ndarray) else type(value)


def check_fields(value: Any, hint: Any, where: str, examples: Examples) -> None:
    """Raise `StateError` unless `value` and every object in it are of the declared types; `where` names it."""
    FieldCheck(examples).check(value, hint, where)


class FieldCheck:
    """One walk through a graph of objects; `examples` stand for the classes that declare no fields."""

    def __init__(self, examples: Examples) -> None:
        self._examples = examples
        self._seen: set[int] = set()

    def check(self, value: Any, hint: Any, where: str) -> None:
        """Raise `StateError` unless `value` is of the type `hint`, and what is in it of those declared."""
        if not fits(value, hint):
            raise StateError(f"{where}: expected {named(hint)}, given {brief(value)}")
        self._look_inside(value, where)

    def _look_inside(self, value: Any, where: str) -> None:
        if id(value) in self._seen:
            return
        self._seen.add(id(value))
        if is_object(value):
            self._check_object(value, where)
        for item in contents_of(value):
            self._look_inside(item, where)

    def _check_object(self, value: Any, where: str) -> None:
        declared, given = self._declared(type(value), where), fields_of(value)
        if declared.keys() != given.keys():
            raise StateError(f"{where}: missing or unknown {', '.join(sorted(declared.keys() ^ given.keys()))}")
        for name, hint in declared.items():
            self.check(given[name], hint, f"{where}.{name}")

    def _declared(self, cls: type, where: str) -> Mapping[str, Any]:
        if is_dataclass(cls):
            return declared_fields(cls)
        if cls not in self._examples:
            raise StateError(f"{where}: a {cls.__name__} is not part of a state of this configuration")
        return self._examples[cls]


def named(hint: Any) -> str:
    """A type in an error, with those of its items."""
    kind = re.sub(r"\w+\.|\[\w+, (?=dtype)", "", str(hint)) if getattr(hint, "__args__", ()) else ""
    return kind or str(getattr(hint, "__name__", hint))


def brief(value: Any) -> str:
    """A value in an error: of what holds others only the kind, because what is nested can be endless to print."""
    if isinstance(value, np.ndarray):
        return f"an array {value.shape} of {value.dtype}"
    return f"{value!r:.60}" if type(value) in PLAIN else f"{type(value).__name__}{_inside(value)}"


def _inside(value: Any) -> str:
    kinds = sorted({type(item).__name__ for item in contents_of(value)})
    return f" of {', '.join(kinds):.60}" if kinds else ""


def is_object(value: Any) -> bool:
    """True for an object of this package with custom fields."""
    return type(value).__module__.split(".")[0] == PACKAGE and not isinstance(value, Enum | Settings)


@cache
def declared_fields(cls: type) -> Mapping[str, Any]:
    """The fields of a dataclass with their types."""
    hints = get_type_hints(cls)
    return {field.name: hints[field.name] for field in fields(cls)}


def fits(value: Any, hint: Any) -> bool:
    """True when `value` is of the type `hint`, the items of containers too; of objects only the class is looked at."""
    if hint is Any:
        return True
    origin = get_origin(hint)
    if origin is None:
        return is_a(value, type(None) if hint is None else hint)
    if hasattr(origin, "__value__"):  # an alias with parameters, as NumPy's NDArray is from Python 3.12 on
        return fits(value, origin.__value__[get_args(hint)])
    return GENERIC[origin](value, get_args(hint))


def is_a(value: Any, cls: Any) -> bool:
    """As `isinstance`; but True and what exceeds `MOST` are no numbers, a whole number is a float, and a protocol is
    known by its names."""
    if getattr(cls, "_is_protocol", False):
        return all(hasattr(value, name) for name in vars(cls) if not name.startswith("_"))
    if cls in SCALARS:
        small = not isinstance(value, int) or abs(value) < MOST
        return isinstance(value, SCALARS[cls]) and small and (cls is bool or not isinstance(value, bool))
    return isinstance(value, cls)


def is_array(value: Any, args: tuple[Any, ...]) -> bool:
    """True for an array of the element type in `args`, as `NDArray` has it."""
    (kind,) = get_args(args[1])
    return isinstance(value, np.ndarray) and (kind is Any or issubclass(value.dtype.type, kind))


def is_tuple(value: Any, args: tuple[Any, ...]) -> bool:
    """True for a tuple of these items; of any length with an ellipsis."""
    if not isinstance(value, tuple):
        return False
    hints = args[:1] * len(value) if args[-1:] == (Ellipsis,) else args
    return len(value) == len(hints) and all(fits(item, hint) for item, hint in zip(value, hints, strict=True))


def is_dict(value: Any, args: tuple[Any, ...]) -> bool:
    """True for a dict of these keys and values."""
    return isinstance(value, dict) and all(fits(k, args[0]) and fits(v, args[1]) for k, v in value.items())


def items_of(cls: type[Collection[Any]]) -> Callable[[Any, tuple[Any, ...]], bool]:
    """The test for a container with items of one type."""
    return lambda value, args: isinstance(value, cls) and all(fits(item, args[0]) for item in value)


def is_one_of(value: Any, args: tuple[Any, ...]) -> bool:
    """True for a value of one of these types."""
    return any(fits(value, hint) for hint in args)


SCALARS: dict[Any, Any] = {bool: bool | np.bool_, int: int | np.integer, float: float | int | np.number, str: str}
GENERIC: dict[Any, Callable[[Any, tuple[Any, ...]], bool]] = {
    Union: is_one_of,
    types.UnionType: is_one_of,
    Literal: lambda value, args: value in args,
    np.ndarray: is_array,
    tuple: is_tuple,
    dict: is_dict,
    list: items_of(list),
    set: items_of(set),
    frozenset: items_of(frozenset),
}
