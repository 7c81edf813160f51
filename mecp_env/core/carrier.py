"""What the stages pass to each other: forty carriers in every control step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar, dataclass_transform

T = TypeVar("T")


@dataclass_transform(eq_default=False, frozen_default=True)
def carrier(cls: type[T]) -> type[T]:
    """A dataclass with slots, to which the type checker lets nobody assign (a frozen one takes 2 us more)."""
    return dataclass(slots=True, eq=False)(cls)
