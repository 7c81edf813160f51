"""Frozen dataclasses that are made often: forty of them in every control step."""

from __future__ import annotations

from dataclasses import fields, make_dataclass
from typing import Any, TypeVar

T = TypeVar("T", bound=type[Any])


def quick(cls: T) -> T:
    """`cls`, a frozen dataclass with slots, made ten times as fast: only the type checker refuses to assign to a field.

    At run time a frozen dataclass sets each field through a function that goes around its own refusal.
    """
    del cls.__setattr__, cls.__delattr__
    hooks = {"__post_init__": cls.__post_init__} if hasattr(cls, "__post_init__") else {}
    columns = [(part.name, part.type, part) for part in fields(cls)]
    cls.__init__ = make_dataclass(cls.__name__, columns, namespace=hooks, slots=True).__init__  # type: ignore[misc]
    return cls
