"""Statistics of buildings, compared with their specification and with manual counts."""

import pytest

from mecp_env.world.config import GeneratorSpec
from mecp_env.world.doors import building_figures
from mecp_env.world.generator import generate
from mecp_env.world.layout import load_layout


def test_the_figures_of_two_rooms_are_those_counted_by_hand() -> None:
    figures = building_figures(load_layout("two_rooms"))
    assert (figures.rooms, figures.doors, figures.loops, figures.obstacles) == (2, 1, 0, 0)
    assert figures.faces == figures.corners == 12  # four of each room, four of the door's jambs
    assert figures.longest_corridor_m == 0.0


def test_declared_loops_and_corridors_come_out() -> None:
    for seed in range(3):
        layout = generate(GeneratorSpec.preset("hard"), seed)
        figures = building_figures(layout)
        assert (figures.rooms, figures.loops, figures.obstacles) == (14, 3, len(layout.obstacles))
        assert figures.longest_corridor_m > 6.0
        assert figures.floor_m2 < figures.width_m * figures.height_m


def test_only_a_narrow_room_is_a_corridor() -> None:
    assert building_figures(load_layout("office")).longest_corridor_m == pytest.approx(16.0, abs=0.1)
