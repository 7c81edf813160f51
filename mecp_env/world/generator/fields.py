"""Fields of a generated building, by the names and kinds of `GeneratorSpec`, before any is built."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, get_args

from mecp_env.core.settings import as_many, as_range, guess, number
from mecp_env.world.generator.spec import GeneratorSpec, Piece, Shape

FIELDS = tuple(GeneratorSpec.model_fields)
WORDS = {*get_args(Shape), *get_args(Piece)}  # possible values of the fields with words
Value = float | tuple[float, ...] | tuple[str, ...]


def check_fields(spec: Mapping[str, Any]) -> dict[str, Value]:
    """The fields, each as what `GeneratorSpec` takes there: a number, a range (low, high), or words.

    Raises `ValueError` for a name that is no field, and a value of another kind; bounds are left to `GeneratorSpec`.
    """
    for name in spec:
        if name not in FIELDS:
            raise ValueError(f"{name} is no field of GeneratorSpec{guess(name, FIELDS)}")
    return {name: _value(name, given) for name, given in spec.items()}


def _value(name: str, given: Any) -> Value:
    default = GeneratorSpec.model_fields[name].default
    if not isinstance(default, tuple):
        return _number(name, given)
    if isinstance(default[0], str):
        return _words(name, given)
    if isinstance(given, tuple | list):
        return tuple(_number(name, end) for end in as_range(given))
    return _number(name, given)


def _number(name: str, given: Any) -> float:
    try:
        found = float(number(given))
    except (TypeError, OverflowError):
        raise ValueError(f"{name}: Input should be a valid number") from None
    if not math.isfinite(found):
        raise ValueError(f"{name}: Input should be a finite number")
    return found


def _words(name: str, given: Any) -> tuple[str, ...]:
    words = as_many(given)
    if not isinstance(words, tuple | list) or not all(isinstance(word, str) for word in words):
        raise ValueError(f"{name}: one word or more expected")
    return tuple(words)
