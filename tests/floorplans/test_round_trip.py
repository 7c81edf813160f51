"""Buildings drawn with pixels and read again: the same rooms, doors and walls, even with walls of one pixel."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from shapely.geometry import Polygon

from mecp_env.core.errors import LayoutError
from mecp_env.floorplans import load_plan
from mecp_env.floorplans.exporters import save_map_server
from mecp_env.world.generator import GeneratorSpec, generate
from mecp_env.world.layout import load_layout, shipped_layouts
from mecp_env.world.outline import build_outline, thin_walls_m
from mecp_env.world.schema import Layout, Pillar

THIN_M = 0.05
EACH = 5  # buildings of a case


def spec(difficulty: str, thin: bool) -> GeneratorSpec:
    return GeneratorSpec.preset(difficulty, **({"wall_thickness_m": THIN_M} if thin else {}))


def building(name: str) -> Layout:
    """A generated building of a difficulty and seed, or a shipped layout."""
    difficulty, colon, seed = name.partition(":")
    return generate(spec(difficulty, thin=False), int(seed)) if colon else load_layout(name)


def again(layout: Layout, folder: Path, resolution_m: float) -> Layout:
    return load_plan(save_map_server(layout, folder / "map", resolution_m)[0])


def doors_apart(layout: Layout, plan: Layout) -> tuple[int, int]:
    """How many doors of `layout` are not in `plan`, within 0.1 m and 0.15 m of its width, and the other way."""
    there = [
        [math.dist(a.centre, b.centre) < 0.1 and abs(a.width_m - b.width_m) < 0.15 for b in plan.doors]
        for a in layout.doors
    ]
    found = np.array(there, bool).reshape(len(layout.doors), len(plan.doors))
    return int((~found.any(axis=1)).sum()), int((~found.any(axis=0)).sum())


def rooms_apart(layout: Layout, plan: Layout) -> int:
    """How many rooms of `layout` are not in `plan`, mostly."""
    mine, theirs = ([Polygon(room.polygon) for room in given.rooms] for given in (layout, plan))
    return sum(not any(f.intersection(r).area > 0.65 * f.union(r).area for f in theirs) for r in mine)


def pillars_apart_m(layout: Layout, plan: Layout) -> float:
    """The largest distance of a pillar from one of the plan, and difference of its radius."""
    mine, theirs = ([o for o in given.obstacles if isinstance(o, Pillar)] for given in (layout, plan))
    assert len(mine) == len(theirs)
    off = [min(math.dist((*a.centre, a.radius_m), (*b.centre, b.radius_m)) for b in theirs) for a in mine]
    return max(off, default=0.0)


def comes_back(layout: Layout, plan: Layout) -> None:
    """All rooms and doors do."""
    assert (len(plan.rooms), len(plan.doors)) == (len(layout.rooms), len(layout.doors))
    assert (doors_apart(layout, plan), rooms_apart(layout, plan)) == ((0, 0), 0)


@pytest.mark.parametrize("name", [*shipped_layouts(), "easy:0", "medium:1", "medium:2", "hard:3"])
def test_a_layout_comes_back_from_map_server(name: str, tmp_path: Path) -> None:
    layout = building(name)
    for resolution_m in (0.03, 0.05) if name in ("paper", "office", "furnished") else (0.05,):
        plan = again(layout, tmp_path, resolution_m)
        comes_back(layout, plan)
        assert name != "furnished" or pillars_apart_m(layout, plan) < 0.04


def walls_off_m(layout: Layout, plan: Layout) -> float:
    """Mean distance between the walls of both."""
    a, b = build_outline(layout).free_area, build_outline(plan).free_area
    return float(a.symmetric_difference(b).area / a.length)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("building", "thin", "resolution_m"),
    [
        ("hard:6", True, 0.05),  # its rings crossed themselves: 7 of 14 rooms were left
        ("hard:8", True, 0.05),
        ("hard:16", True, 0.05),  # the end of a wall along a slanted one
        ("huge:2", True, 0.05),
        ("huge:10", True, 0.05),  # both faces of a wall in one line
        ("huge:13", False, 0.05),  # the ring began amid the end of a wall
        ("huge:3", False, 0.025),  # taken for ragged, and drawn with 9 cm
        ("hard:2", False, 0.025),  # the end of a wall in two oblique edges
        ("hard:21", False, 0.025),
        ("medium:4", True, 0.025),
    ],
)
def test_rooms_doors_and_walls_come_back(building: str, thin: bool, resolution_m: float, tmp_path: Path) -> None:
    difficulty, seed = building.split(":")
    layout = generate(spec(difficulty, thin), int(seed))
    plan = again(layout, tmp_path, resolution_m)
    comes_back(layout, plan)
    assert walls_off_m(layout, plan) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize(
    ("thin", "resolution_m", "first"), [(False, 0.05, 0), (False, 0.025, 15), (True, 0.05, 30), (True, 0.025, 45)]
)
@pytest.mark.parametrize("difficulty", ["easy", "medium", "hard", "huge"])
def test_buildings_come_back(difficulty: str, thin: bool, resolution_m: float, first: int, tmp_path: Path) -> None:
    """Each case has other buildings; with EACH = 15 these are 60 of each difficulty, and take five minutes.

    A shelf in front of a corner can look like a jamb; in walls of one pixel a jamb may be blurred away.
    """
    doors = missing = false = 0
    off = []
    for seed in range(first, first + EACH):
        layout = generate(spec(difficulty, thin), seed)
        plan = again(layout, tmp_path, resolution_m)
        lost, made = doors_apart(layout, plan)
        doors, missing, false = doors + len(layout.doors), missing + lost, false + made
        off.append(walls_off_m(layout, plan))
    one_pixel = thin and resolution_m == THIN_M
    assert missing <= (0.015 if one_pixel else 0.005) * doors
    assert false <= 0.005 * doors + 0.5
    assert np.median(off) < 0.015
    assert max(off) < 0.05


def test_walls_thinner_than_a_pixel_are_not_drawn_with_holes(tmp_path: Path) -> None:
    layout = generate(spec("easy", True), 0)
    with pytest.raises(LayoutError, match=r"resolution_m: \d+\.\d m of walls are thinner than a pixel of 0\.08 m"):
        save_map_server(layout, tmp_path / "map", 0.08)
    with pytest.raises(LayoutError, match="thinner than a pixel"):
        save_map_server(again(layout, tmp_path, 0.025), tmp_path / "map", 0.08)
    assert save_map_server(generate(spec("easy", False), 0), tmp_path / "map", 0.1)


def test_the_length_of_thin_walls() -> None:
    floor = Polygon([(0, 0), (4, 0), (4, 2), (2.03, 2), (2.03, 0.5), (2, 0.5), (2, 2), (0, 2)])
    assert thin_walls_m(floor, 0.02) == 0.0
    assert thin_walls_m(floor, 0.04) == pytest.approx(1.5, abs=0.05)
