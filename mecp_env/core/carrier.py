"""What the stages pass to each other: forty carriers in every control step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar, dataclass_transform

T = TypeVar("T")
_made = list[type]()


@dataclass_transform(eq_default=False, frozen_default=True)
def carrier(cls: type[T]) -> type[T]:
    """A dataclass with slots, to which the type checker lets nobody assign (a frozen one takes 2 us more)."""
    made = dataclass(slots=True, eq=False)(cls)
    _made.append(made)
    return made


def carriers() -> tuple[type, ...]:
    """All classes of carriers: an array in one may be read-only."""
    return tuple(_made)
