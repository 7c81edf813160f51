"""The base of every configuration section: frozen, validated, unknown keys refused, JSON both ways."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from mecp_env.errors import ConfigError


def describe(error: ValidationError, root: str) -> str:
    """One line per wrong field: its path, the value given and the bound it breaks."""
    return "; ".join(
        f"{'.'.join([root, *map(str, e['loc'])])}: {e['msg']} (given: {e['input']!r:.80})" for e in error.errors()
    )


def no_bool(value: Any) -> Any:
    """`value` itself. Raises `ValueError` for True and False, which are no numbers."""
    if isinstance(value, bool | np.bool_):
        raise ValueError("Input should be a number")
    return value


class Settings(BaseModel):
    """A frozen section of the configuration tree; a wrong field raises `ConfigError`."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, ser_json_inf_nan="constants")

    def __init__(self, **fields: Any) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise ConfigError(describe(error, type(self).__name__)) from None

    @classmethod
    def parse(cls, given: Self | dict[str, Any] | None) -> Self:
        """The section that `given` stands for: itself, a dict of fields, or None for the defaults."""
        if isinstance(given, cls):
            return given
        if given is None:
            return cls()
        if not isinstance(given, dict):
            raise ConfigError(f"{cls.__name__}: expected a dict or {cls.__name__}, given {type(given).__name__}")
        return cls(**given)
