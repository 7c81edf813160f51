"""What a compiled function depends on, as a short text: the key of its entry in the cache.

That is its own bytecode and constants, and the values of all names that it reads: compiled functions that it calls
(with everything that those use), numbers, enumerations, arrays. An edit of a comment, or of another function in the
same file, changes nothing; an edit of a called function in another file, or of a constant there, does.
"""

from __future__ import annotations

import enum
import hashlib
from collections.abc import Callable, Iterator
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

FORMAT = "8: nogil, numpy errors, no wrapper for C, no variants of numbers, own boxes"  # changes with `compiled`


def fingerprint(function: Callable[..., Any]) -> str:
    """16 hexadecimal digits that change when anything changes that the compiled `function` depends on."""
    text = "\n".join([FORMAT, *_of_function(function, set())])
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _of_function(function: Any, seen: set[int]) -> Iterator[str]:
    """Lines about a function and all that it uses; a function that is being described already is only named."""
    yield f"function {function.__module__}.{function.__qualname__}"
    if id(function) in seen:
        return
    seen.add(id(function))
    yield from _of_code(function.__code__, function.__doc__)
    used = sorted(set(_names(function.__code__)))
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    known = function.__globals__ | {name: cell.cell_contents for name, cell in cells}
    for name in used:
        if name in known:
            yield from _of_value(name, known[name], used, seen)
    yield f"defaults {function.__defaults__!r}"


def _of_code(code: CodeType, doc: str | None) -> Iterator[str]:
    """Lines about bytecode and constants; a docstring is neither."""
    yield f"code {code.co_code.hex()} {code.co_names} {code.co_varnames} {code.co_freevars}"
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _of_code(constant, None)
        elif isinstance(constant, frozenset):
            yield f"constant {sorted(map(repr, constant))}"
        elif constant is not doc:
            yield f"constant {constant!r}"


def _names(code: CodeType) -> Iterator[str]:
    """Names that the code reads: globals, attributes, and variables of functions around it."""
    yield from code.co_names
    yield from code.co_freevars
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _of_value(name: str, value: Any, used: list[str], seen: set[int]) -> Iterator[str]:
    """Lines about the value of a name; of a module of our own, about those members that are used."""
    function = getattr(value, "py_func", value)  # of a compiled compiled function
    if isinstance(function, FunctionType):
        yield from _of_function(function, seen)
    elif isinstance(value, ModuleType):
        yield f"{name} = module {value.__name__}"
        ours = value.__name__.startswith("mecp_env")
        for member in [member for member in used if ours and hasattr(value, member)]:
            yield from _of_value(member, getattr(value, member), used, seen)
    else:
        yield f"{name} = {_plain(value)}"


def _plain(value: Any) -> str:
    """A value as text that is the same in every process."""
    if isinstance(value, np.ndarray):
        return f"array {value.dtype} {value.shape} {value.tobytes().hex()}"
    if isinstance(value, enum.EnumType):
        members: dict[str, enum.Enum] = dict(value.__members__)
        return f"enumeration {[(name, member.value) for name, member in members.items()]}"
    if isinstance(value, type) or callable(value):
        named = getattr(value, "__qualname__", type(value).__qualname__)
        return f"{getattr(value, '__module__', '')}.{named} {getattr(value, '_fields', '')}"
    return repr(value)
