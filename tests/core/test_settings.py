"""The numbers of a section of the configuration, as compiled functions take them."""

import math

import numpy as np
import pytest

from mecp_env.core.jit import compiled
from mecp_env.core.settings import Settings


class Section(Settings):
    width_m: tuple[float, float] = (0.6, 1.95)
    turn_deg: float = 25.0
    beams: int = 5
    guard: bool = True
    method: str = "mecp"


@compiled
def look_inside(record):
    """Reads every kind of field."""
    limits = record[0]
    return limits.width_m[1] + limits.turn_rad + limits.beams + (1000.0 if limits.guard else 0.0)


def test_compiled_functions_read_the_fields_by_name():
    section = Section(turn_deg=30.0)
    assert look_inside(section.record) == 1.95 + math.radians(30.0) + 5 + 1000.0


def test_a_record_is_made_once_is_read_only_and_no_part_of_the_section():
    section = Section()
    assert section.record is section.record
    with pytest.raises(ValueError, match="read-only"):
        section.record["beams"] = 6
    assert section == Section()
    assert "record" not in section.model_dump()


def test_a_copy_with_other_values_has_its_own_record():
    section = Section(turn_deg=30.0)
    assert section.record["turn_deg"][0] == 30.0
    assert section.model_copy(update={"turn_deg": 60.0}).record["turn_deg"][0] == 60.0


def test_texts_are_left_out_and_the_layout_does_not_depend_on_values():
    assert Section().record.dtype == Section(beams=7, width_m=(0.1, 0.2)).record.dtype
    assert set(Section().record.dtype.names) == {"width_m", "turn_deg", "turn_rad", "beams", "guard"}


def test_degrees_become_radians_as_the_standard_library_has_them():
    for degrees in np.linspace(-180.0, 180.0, 999).tolist():
        assert Section(turn_deg=degrees).record["turn_rad"][0] == math.radians(degrees)
