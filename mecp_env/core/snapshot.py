"""Plain data from living objects and back, bit for bit: no pickle, so that a stored state runs no code when it is read.

What comes out holds None, bools, ints, floats, strings, arrays, lists and dicts with string keys only. An object stands
as a dict with the one key "@KIND", one of `KINDS`; arrays and objects that are reached twice stay one. A class must be
defined in a module of `mecp_env` that states come from, or be one that this process has admitted: what such a module
only imports, such as a connection that closes a file when it goes, is not made.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from enum import Enum
from typing import Any

import numpy as np

from mecp_env.core.errors import MecpError
from mecp_env.core.settings import Settings

PACKAGE = "mecp_env"
PACKAGES = tuple(  # whose objects a state holds
    f"{PACKAGE}.{part}." for part in ("core", "episode", "evaluation", "lab", "planning", "slam", "world")
)
MOST_IN_KEY = 10_000  # values in a key or a member of a set, each counted as often as it is reached
PLAIN = (type(None), bool, int, float, str)
ADMITTED: dict[str, type] = {}  # classes from elsewhere, by name


class StateError(MecpError):
    """A state is of another version, of another configuration, or damaged."""


class Encoder:
    """Turns a graph of plain objects into plain data; one encoder for one graph."""

    def __init__(self) -> None:
        self._number: dict[int, int] = {}  # id of an object -> its place in the order of first visits
        self._alive: list[Any] = []  # keeps the ids valid

    def encode(self, value: Any) -> Any:
        """Plain data that stands for `value`.

        Raises `TypeError` for what a state must not hold (a function, ...), `StateError` for an object that has it.
        """
        if type(value) in PLAIN:
            return value
        if isinstance(value, Enum):
            return {"@enum": [name_of(type(value)), value.value]}
        if isinstance(value, np.generic):
            return {"@scalar": np.array(value)}
        if isinstance(value, Settings):
            return {"@settings": [name_of(type(value)), value.model_dump(mode="json")]}
        if id(value) in self._number:
            return {"@same": self._number[id(value)]}
        self._number[id(value)] = len(self._alive)
        self._alive.append(value)
        return self._container(value)

    def _container(self, value: Any) -> dict[str, Any]:
        if isinstance(value, np.ndarray):
            return array_data(value)
        if isinstance(value, np.random.Generator):
            return {"@generator": generator_data(value)}
        if type(value) in (list, tuple, set, frozenset):
            return {f"@{type(value).__name__}": self._items(value)}
        if type(value) is dict:
            return {"@dict": [self._items(pair) for pair in value.items()]}
        fields = {name: self._field(value, name, item) for name, item in fields_of(value).items()}
        return {"@object": [name_of(type(value)), fields]}

    def _field(self, owner: Any, name: str, item: Any) -> Any:
        try:
            return self.encode(item)
        except TypeError as error:
            raise StateError(f"{type(owner).__name__}.{name}: {error}") from None

    def _items(self, values: Any) -> list[Any]:
        """The items in their order; those of a set sorted."""
        return [self.encode(item) for item in (sorted(values) if isinstance(values, set | frozenset) else values)]


class Decoder:
    """Turns what an `Encoder` made back into objects."""

    def __init__(self) -> None:
        self._made: list[Any] = []
        self._sizes: dict[int, int] = {}  # id of a tuple, frozenset or object -> values in it, as often as reached

    def decode(self, data: Any) -> Any:
        """The value that `data` stands for. Raises `StateError` when it is damaged."""
        if type(data) in PLAIN:
            return data
        if not isinstance(data, dict) or len(data) != 1:
            raise StateError(f"state: expected plain data with one key, given {type(data).__name__}")
        ((kind, content),) = data.items()
        if kind not in KINDS:
            raise StateError(f"state: {kind!r:.40} is no kind of value")
        return KINDS[kind](self, content)

    def _keep(self, value: Any) -> Any:
        self._made.append(value)
        return value

    def _key(self, data: Any) -> Any:
        """What is hashed: Python visits a value in it as often as it is reached, which nesting can make endless."""
        key = self.decode(data)
        if self._sizes.get(id(key), 1) > MOST_IN_KEY:
            raise StateError(f"state: a key of more than {MOST_IN_KEY} values")
        return key

    def _weigh(self, value: Any, items: list[Any]) -> Any:
        self._sizes[id(value)] = min(1 + sum(self._sizes.get(id(item), 1) for item in items), MOST_IN_KEY + 1)
        return value

    def _same(self, number: int) -> Any:
        if not 0 <= number < len(self._made):
            raise StateError(f"state: object {number} is not among the {len(self._made)} before it")
        return self._made[number]

    def _enum(self, content: list[Any]) -> Any:
        return class_of(content[0], Enum)(content[1])

    def _scalar(self, content: np.ndarray[Any, Any]) -> Any:
        return real_array(content)[()]

    def _settings(self, content: list[Any]) -> Any:
        return class_of(content[0], Settings)(**content[1])

    def _array(self, content: list[Any]) -> Any:
        array = np.array(real_array(content[0]), order="K", copy=True)
        array.setflags(write=content[1])
        return self._keep(array)

    def _generator(self, content: dict[str, Any]) -> Any:
        return self._keep(make_generator(content))

    def _list(self, content: list[Any]) -> Any:
        made: list[Any] = self._keep([])
        made.extend(self.decode(item) for item in content)
        return made

    def _frozen(self, kind: type, content: list[Any]) -> Any:
        place = len(self._made)
        self._made.append(None)  # keeps the order of first visits: a frozen container is made after its items
        items = [self.decode(item) if kind is tuple else self._key(item) for item in content]
        self._made[place] = kind(items)
        return self._weigh(self._made[place], items)

    def _dict(self, content: list[Any]) -> Any:
        made: dict[Any, Any] = self._keep({})
        for key, item in content:
            made[self._key(key)] = self.decode(item)
        return made

    def _object(self, content: list[Any]) -> Any:
        cls = class_of(content[0], object)
        made = self._keep(cls.__new__(cls))
        for name, item in content[1].items():
            object.__setattr__(made, name, self.decode(item))
        return self._weigh(made, list(fields_of(made).values()))


KINDS: Mapping[str, Callable[[Decoder, Any], Any]] = {
    "@same": Decoder._same,
    "@enum": Decoder._enum,
    "@scalar": Decoder._scalar,
    "@settings": Decoder._settings,
    "@array": Decoder._array,
    "@generator": Decoder._generator,
    "@list": Decoder._list,
    "@tuple": lambda decoder, content: decoder._frozen(tuple, content),
    "@set": lambda decoder, content: decoder._frozen(set, content),
    "@frozenset": lambda decoder, content: decoder._frozen(frozenset, content),
    "@dict": Decoder._dict,
    "@object": Decoder._object,
}


def real_array(value: Any) -> np.ndarray[Any, Any]:
    """`value`, an array of numbers, texts or rows. Raises `StateError` for anything else, as an array of objects."""
    if type(value) is not np.ndarray or value.dtype.hasobject:
        raise StateError(f"state: expected an array of plain values, given {type(value).__name__}")
    return value


def encode(value: Any) -> Any:
    """Plain data that stands for `value`; shares no memory with it."""
    return Encoder().encode(value)


@contextmanager
def damage_refused() -> Iterator[None]:
    """Turns whatever unexpected data makes Python raise into `StateError`."""
    try:
        yield
    except StateError:
        raise
    except MecpError as error:
        raise StateError(f"state: {error}") from None
    except (TypeError, ValueError, LookupError, AttributeError, ArithmeticError, RecursionError, MemoryError) as error:
        raise StateError(f"state: damaged ({error!r:.80})") from None


def decode(data: Any) -> Any:
    """The value that `encode` made `data` from; shares no memory with it. Raises `StateError`."""
    with damage_refused():
        return Decoder().decode(data)


def array_data(array: np.ndarray[Any, Any]) -> dict[str, Any]:
    """A copy of `array`, and whether it may be written to (compiled code tells the two apart)."""
    if array.dtype.hasobject:
        raise TypeError("a state holds no arrays of objects")
    return {"@array": [np.array(array, order="K", copy=True), bool(array.flags.writeable)]}


def generator_data(generator: np.random.Generator) -> dict[str, Any]:
    """The state of a PCG64 generator as plain data."""
    return dict(generator.bit_generator.state)


def make_generator(data: dict[str, Any]) -> np.random.Generator:
    """The generator that `generator_data` described. Raises `StateError`."""
    bits = np.random.PCG64(0)
    with damage_refused():
        bits.state = data  # type: ignore[assignment]  # NumPy checks it
    return np.random.Generator(bits)


def fields_of(value: Any) -> dict[str, Any]:
    """The attributes of an object of this package, those in slots too."""
    name_of(type(value))
    slots = [name for cls in type(value).__mro__ for name in getattr(cls, "__slots__", ())]
    fields = {name: getattr(value, name) for name in slots if hasattr(value, name)}
    return fields | getattr(value, "__dict__", {})


def admit(cls: type) -> None:
    """Let states hold objects of a class from elsewhere: its attributes must be what a state can hold."""
    ADMITTED[f"{cls.__module__}:{cls.__qualname__}"] = cls


def name_of(cls: type) -> str:
    """`module:Class` of a class of this package, or of one admitted. Raises `TypeError` for any other."""
    name = f"{cls.__module__}:{cls.__qualname__}"
    if cls.__module__.split(".")[0] != PACKAGE and name not in ADMITTED:
        raise TypeError(f"a state holds no {cls.__module__}.{cls.__qualname__}")
    return name


def class_of(name: str, base: type) -> Any:
    """The class `module:Class` of this package, or the one admitted, below `base`. Raises `StateError`."""
    module, _, cls = str(name).partition(":")
    if name in ADMITTED and issubclass(ADMITTED[name], base):
        return ADMITTED[name]
    if not module.startswith(PACKAGES):
        raise StateError(f"state: {name!r:.80} is not a class of {PACKAGE} that a state holds")
    try:
        found = getattr(importlib.import_module(module), cls)
    except (ImportError, AttributeError):
        raise StateError(f"state: there is no class {name!r:.80}") from None
    if not isinstance(found, type) or not issubclass(found, base) or found.__module__ != module:
        raise StateError(f"state: {name!r:.80} is not a class of that kind")
    return found
