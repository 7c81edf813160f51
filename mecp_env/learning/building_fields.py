"""Fields of `GeneratorSpec` on the command line of a training run: numbers, ranges and words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tyro.constructors import PrimitiveConstructorSpec

from mecp_env.world.generator.fields import FIELDS, WORDS


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
        return word if expected and word.replace("-", "_") not in FIELDS else None


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
