"""The base of every configuration section: frozen, validated, unknown keys refused, JSON both ways.

Sections of which a named preset gives the fields that are not set.
"""

from __future__ import annotations

import difflib
import re
import reprlib
import warnings
from collections.abc import Iterable, Iterator, Mapping
from functools import cache, cached_property
from importlib.metadata import distributions
from typing import Annotated, Any, ClassVar, Literal, Self, get_args, get_origin

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    ModelWrapValidatorHandler,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from mecp_env.core.carriers import Rows, row_type
from mecp_env.core.errors import ConfigError

PARTS = "mecp_env"  # the group of entry points
MOST_FIELDS = 200  # of a part of an untrusted document
MOST_TOLD = 8  # wrong fields that one message tells of
NUMBERS = {int, float, type(None), tuple, ...}  # the kinds of fields that are numbers and ranges of them
UNION = re.compile(r"(literal|tuple)\[")  # how pydantic names a part of a union in a path
PLACEHOLDER = re.compile(r"'([^']+)'")  # the words in what pydantic says is expected


def describe(error: ValidationError, root: str, model: type[BaseModel]) -> str:
    """A few wrong fields of a `model`: the path of each, the value given, the bound it breaks, a guess what was meant.

    A field that is wrong because of another one within it is left out.
    """
    errors = list(_innermost(error))
    told = [_told(one, root, model) for one in errors[:MOST_TOLD]]
    more = [f"and {len(errors) - MOST_TOLD} more"] if len(errors) > MOST_TOLD else []
    return "; ".join(told + more)


def _innermost(error: ValidationError) -> Iterator[Any]:
    """The errors without those of a field that holds another wrong one; an unknown name before what is missing."""
    errors: list[Any] = error.errors(include_url=False)
    paths = {one["loc"] for one in errors}
    outer = {path[:length] for path in paths for length in range(1, len(path))}
    kept = [one for one in errors if one["loc"] not in outer]
    return iter(sorted(kept, key=lambda one: one["type"] != "extra_forbidden"))


def _told(one: Any, root: str, model: type[BaseModel]) -> str:
    path, kind, context = one["loc"], one["type"], one.get("ctx", {})
    steps = [step for step in map(str, path) if step != "[key]" and not UNION.match(step)]
    place, given = ".".join([root, *steps])[:200], one["input"]
    if isinstance(context.get("error"), ConfigError):
        return _further_out(str(context["error"]), place)
    if kind == "extra_forbidden":
        return f"{place}: no such field{_meant(path, model)} (given: {shown(given)})"
    if kind in ("literal_error", "union_tag_invalid"):
        word = context.get("tag", given)
        known = PLACEHOLDER.findall(str(context.get("expected") or context.get("expected_tags")))
        return f"{place}: {one['msg']}{guess(word, known)} (given: {shown(given)})"
    said = f"{place}: {one['msg'].removeprefix('Value error, ')}"
    return said if _says_enough(one) else f"{said} (given: {shown(given)})"


def _meant(path: tuple[int | str, ...], model: type[BaseModel]) -> str:
    """The field nearest to an unknown one; all that there are where none is near."""
    known = fields_at(model, path[:-1])
    return guess(path[-1], known) or f" (fields: {', '.join(known)})"


def _says_enough(one: Any) -> bool:
    """Whether an error needs no value: a field that is missing, or a check of the whole, which names the value."""
    if one["type"] == "missing":
        return isinstance(one["input"], dict)
    return (one["type"], one["loc"]) == ("value_error", ())


def _further_out(said: str, place: str) -> str:
    """What a section says of its fields, told by the one around it: by their whole path, the value once."""
    section = said[: re.match(r"\w*", said).end()]  # type: ignore[union-attr]
    return re.sub(rf"(^|; ){section}(?=[.:])", lambda found: found[1] + place, said)


def fields_at(model: type[BaseModel], path: Iterable[int | str]) -> list[str]:
    """The names of the fields that there are at a path below a model."""
    models = [model]
    for key in path:
        models = _models_at(models, key) or models  # the number of an entry, or the kind of one, leads no deeper
    return [name for m in models for name in m.model_fields]


def _models_at(models: list[type[BaseModel]], key: int | str) -> list[type[BaseModel]]:
    fields = [model.model_fields[key] for model in models if isinstance(key, str) and key in model.model_fields]
    return [inner for field in fields for inner in _models_in(field.annotation)]


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models_in(part)]


def guess(word: object, known: Iterable[str]) -> str:
    """`; did you mean 'medium'?`, of the known words the nearest to a wrong one; nothing when none is near."""
    near = difflib.get_close_matches(str(word)[:80], list(known), n=1, cutoff=0.5)
    return f"; did you mean {near[0]!r}?" if near else ""


def shown(value: Any) -> str:
    """The beginning of what was given, for a message."""
    try:
        return f"{reprlib.repr(value):.80}"
    except ValueError:  # an integer of too many digits
        return type(value).__name__


def as_range(value: Any) -> Any:
    """A single number as the range from it to itself, a range as it is. Raises `ValueError` for anything else."""
    if isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool):
        return (float(value), float(value))
    if not isinstance(value, tuple | list) or len(value) != 2:
        raise ValueError("a number or a range of two, the lower first, expected")
    return value


def as_many(value: Any) -> Any:
    """A single word as a tuple of one; anything else as it is."""
    return (value,) if isinstance(value, str) else value


def number(value: Any) -> Any:
    """`value` itself. Raises `ValueError` for a truth value or a text, which may look like a number."""
    if isinstance(value, bool | np.bool_ | str | bytes):
        raise ValueError("Input should be a number")
    return value


def named(fields: Any) -> Any:
    """`fields` themselves. Raises `ValueError` where a mapping has keys that are no texts."""
    wrong = next((name for name in fields if not isinstance(name, str)), None)
    if wrong is not None or None in fields:
        raise ValueError(f"{shown(wrong)}: no such field, a text expected")
    return fields


def few(fields: Any) -> Any:
    """`fields` themselves. Raises `ValueError` for so many that the errors of all of them would fill the memory."""
    if isinstance(fields, Mapping) and len(fields) > MOST_FIELDS:
        raise ValueError(f"{len(fields)} fields, at most {MOST_FIELDS}")
    return fields


@cache
def _kinds(model: type[BaseModel], field: str) -> frozenset[Any]:
    """The types of which the value of a field may be, with `tuple` those of its entries."""
    return frozenset(_leaves(model.model_fields[field].annotation))


def _leaves(annotation: Any) -> list[Any]:
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is None or origin is Literal:
        return [origin or annotation]
    inner = [leaf for part in (parts[:1] if origin is Annotated else parts) for leaf in _leaves(part)]
    return [tuple, *inner] if origin is tuple else inner


class Settings(BaseModel):
    """A frozen section of the configuration tree; a wrong field raises `ConfigError`."""

    DERIVED: ClassVar[tuple[str, ...]] = ()  # properties that are in the `record` beside the fields

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, ser_json_inf_nan="constants")

    @field_validator("*", mode="before")
    @classmethod
    def _of_its_kind(cls, value: Any, info: ValidationInfo) -> Any:
        """Refuse numbers and truth values in disguise ("10", True for 1), which pydantic would take."""
        assert info.field_name is not None
        if isinstance(value, Mapping):
            named(value)
        kinds = _kinds(cls, info.field_name)
        if kinds == {bool} and not isinstance(value, bool):
            raise ValueError("Input should be true or false")
        if kinds <= NUMBERS:
            for item in value if isinstance(value, tuple | list) else () if tuple in kinds else (value,):
                number(item)
        return value

    def __init__(self, **fields: Any) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise ConfigError(describe(error, type(self).__name__, type(self))) from None

    @cached_property
    def record(self) -> Rows:
        """(1,) the numbers of this section by name, as compiled functions take them: `limits = record[0]`.

        One argument costs 0.1 us however many fields it has, a NamedTuple 0.5 us more. A field `x_deg` comes with its
        twin `x_rad`; a range is an array (2,). Texts and sections inside this one are left out. Read-only.
        """
        columns = {name: np.asarray(getattr(self, name)) for name in (*type(self).model_fields, *self.DERIVED)}
        degrees = [name for name in columns if name.endswith("_deg")]
        columns |= {f"{name.removesuffix('_deg')}_rad": np.radians(columns[name]) for name in degrees}
        kept = {name: column for name, column in columns.items() if column.dtype.kind in "bif"}
        layout = [(name, column.dtype, column.shape) for name, column in kept.items()]
        packed = np.zeros(1, row_type(layout))
        for name, column in kept.items():
            packed[name][0] = column
        packed.setflags(write=False)
        return packed

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """A copy with other values, not validated; what follows from them is computed again."""
        copied = super().model_copy(update=update, deep=deep)
        for derived in copied.__dict__.keys() - type(self).model_fields.keys():
            del copied.__dict__[derived]
        return copied

    @classmethod
    def parse(cls, given: Self | dict[str, Any] | None) -> Self:
        """The section that `given` stands for: itself, a dict of fields, or None for the defaults."""
        if isinstance(given, cls):
            return given
        if given is None:
            return cls()
        if not isinstance(given, dict):
            raise ConfigError(f"{cls.__name__}: expected a dict or {cls.__name__}, given {type(given).__name__}")
        try:
            return cls(**named(given))
        except ConfigError:
            raise
        except ValueError as error:
            raise ConfigError(f"{cls.__name__}.{error}") from None


class PartsWarning(UserWarning):
    """What an installed package announces cannot be imported."""


@cache
def load_parts() -> None:
    """Import what installed packages announce in the group of entry points `mecp_env`: modules that register
    names. One that cannot be imported is reported by a `PartsWarning`, and left out.
    """
    for package in distributions():
        try:
            for module in package.entry_points.select(group=PARTS):
                module.load()
        except (Exception, SystemExit) as error:  # custom code may raise anything
            reason = f"{type(error).__name__}: {error}"
            warnings.warn(
                f"{package.metadata['Name']}: its entry points for {PARTS} are left out ({reason})",
                PartsWarning,
                stacklevel=2,
            )


class Names:
    """The names that a field may hold: built-in ones, and those that a function `by` has registered."""

    def __init__(self, *ours: str, by: str = "") -> None:
        self.ours, self.others, self.by = ours, list[str](), by

    def check(self, name: str) -> str:
        """`name` itself. Raises `ValueError` for an unknown one."""
        if name not in (*self.ours, *self.others):
            load_parts()
        known = [*self.ours, *self.others]
        if name not in known:
            listed = f"{', '.join(map(repr, known[:-1]))} or {known[-1]!r}"
            more = f"; others are registered by {self.by}, in a module for --with" * bool(self.by)
            raise ValueError(f"Input should be {listed}{guess(name, known)}{more}")
        return name

    def add(self, name: object) -> None:
        """Let the field hold `name`, too. Raises `ConfigError` for one of ours, and for what is no name."""
        if not isinstance(name, str) or not name.isidentifier():
            raise ConfigError(f"name: {shown(name)}, letters, digits and _ expected")
        if name in self.ours:
            raise ConfigError(f"name: {name!r} is one of ours ({', '.join(self.ours)}); choose another")
        if name not in self.others:
            self.others.append(name)


class PresetSettings(Settings):
    """A section with a field `preset`: what is not set beside it has the value of the preset, else the default.

    Such a value counts as not set, so that another preset replaces it, and `EnvConfig.to_dict` leaves it out.
    """

    PRESETS: ClassVar[Mapping[str, Mapping[str, Any]]] = {}

    @model_validator(mode="wrap")
    @classmethod
    def _filled(cls, given: Any, build: ModelWrapValidatorHandler[Self]) -> Self:
        if not isinstance(given, Mapping):
            return build(given)
        given = cls.completed(given)
        name = given.get("preset", cls.model_fields["preset"].default)
        preset = cls.PRESETS.get(name, {}) if isinstance(name, str) else {}
        preset = {"preset": name, **preset}
        section = build({**preset, **given})
        section.model_fields_set.difference_update(preset.keys() - given.keys())
        return section

    @classmethod
    def completed(cls, given: Mapping[str, Any]) -> Mapping[str, Any]:
        """`given`, with a preset that it stands for without naming it."""
        return given
