"""The numbers of a section of the configuration, as compiled functions take them."""

import math
from functools import cached_property
from typing import ClassVar

import pytest

from mecp_env.core.errors import ConfigError
from mecp_env.core.jit import compiled
from mecp_env.core.settings import Settings


class Section(Settings):
    width_m: tuple[float, float] = (0.6, 1.95)
    turn_deg: float = 25.0
    beams: int = 5
    guard: bool = True
    method: str = "mecp"


class Derived(Settings):
    DERIVED: ClassVar = ("twice",)

    once: int = 5

    @property
    def twice(self) -> int:
        return 2 * self.once

    @cached_property
    def thrice(self) -> int:
        return 3 * self.once


@compiled
def look_inside(record):
    """Reads every kind of field."""
    limits = record[0]
    return limits.width_m[1] + limits.turn_rad + limits.beams + (1000.0 if limits.guard else 0.0)


def test_compiled_functions_read_the_fields_by_name():
    section = Section(turn_deg=30.0)
    assert look_inside(section.record) == 1.95 + math.radians(30.0) + 5 + 1000.0
    assert section.model_copy(update={"turn_deg": 60.0}).record["turn_deg"][0] == 60.0
    assert section.record is section.record
    with pytest.raises(ValueError, match="read-only"):
        section.record["beams"] = 6
    assert "record" not in section.model_dump()
    assert section.record.dtype == Section(beams=7, width_m=(0.1, 0.2)).record.dtype
    assert set(section.record.dtype.names) == {"width_m", "turn_deg", "turn_rad", "beams", "guard"}


def test_a_number_that_follows_from_another_is_in_the_record_but_no_field():
    section = Derived(once=7)
    assert section.thrice == 21  # kept from now on, but in no record: its type would depend on what was asked before
    assert section.record["twice"][0] == 14
    assert section.record.dtype == Derived().record.dtype
    assert section == Derived(once=7)
    assert section.model_copy(update={"once": 8}).record["twice"][0] == 16
    assert "twice" not in section.model_dump()
    with pytest.raises(ConfigError, match=r"Derived\.twice: no such field"):
        Derived(twice=3)
