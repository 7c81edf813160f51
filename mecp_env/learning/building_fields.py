"""Fields of `GeneratorSpec` in the configuration of a training run and on its command line: numbers, ranges, words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from tyro.constructors import PrimitiveConstructorSpec

from mecp_env.core.settings import as_many, as_range, guess, number
from mecp_env.world.generator.spec import GeneratorSpec

DEFAULTS = {name: field.default for name, field in GeneratorSpec.model_fields.items()}
WORDS = {*DEFAULTS["shapes"], *DEFAULTS["pieces"]}  # possible values of the fields with words
Value = float | tuple[float, ...] | tuple[str, ...]


def check_fields(spec: Mapping[str, Any]) -> dict[str, Value]:
    """The fields, each as what `GeneratorSpec` takes there: a number, a range (low, high), or words.

    Raises `ValueError` for a name that is no field, and a value of another kind; bounds are left to `GeneratorSpec`.
    """
    for name in spec:
        if name not in DEFAULTS:
            raise ValueError(f"{name} is no field of GeneratorSpec{guess(name, DEFAULTS)}")
    return {name: _value(name, given) for name, given in spec.items()}


def _value(name: str, given: Any) -> Value:
    default = DEFAULTS[name]
    if isinstance(default, tuple) and isinstance(default[0], str):
        return _words(name, given)
    if isinstance(default, tuple) and isinstance(given, tuple | list):
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


def read_line(words: Sequence[str]) -> dict[str, Any]:
    """`rooms 12 door_width_m 0.7 0.9 shapes L T` of a command line as fields; a word that cannot be a value is a name.

    Raises `ValueError` for a name without a value, and a value without a name.
    """
    fields: dict[str, list[float | str]] = {"": []}
    name = ""
    for word in words:
        value = _as_value(word, expected=bool(name) and not fields[name])
        if value is None:
            name = word.replace("-", "_")
            fields.setdefault(name, [])
        else:
            fields[name].append(value)
    if fields.pop(""):
        raise ValueError(f"{words[0]}: the name of a field comes first, as rooms 12")
    if not all(fields.values()):
        raise ValueError(f"{min(fields, key=lambda name: len(fields[name]))}: a value is missing, as rooms 12")
    return {name: found[0] if len(found) == 1 else tuple(found) for name, found in fields.items()}


def _as_value(word: str, expected: bool) -> float | str | None:
    """A word of the line as a value; None for a name, which is any other word where no value is expected."""
    if word in WORDS:
        return word
    try:
        return float(word)
    except ValueError:
        return word if expected and word.replace("-", "_") not in DEFAULTS else None


def as_words(spec: Mapping[str, Any]) -> list[str]:
    """The fields as on a command line."""
    values = {name: value if isinstance(value, tuple | list) else (value,) for name, value in spec.items()}
    return [word for name, found in values.items() for word in (name, *map(str, found))]


OPTION: PrimitiveConstructorSpec[dict[str, Any]] = PrimitiveConstructorSpec(
    nargs="*",
    metavar="[FIELD VALUE ...]",
    instance_from_str=read_line,
    is_instance=lambda value: isinstance(value, dict),
    str_from_instance=as_words,
)
