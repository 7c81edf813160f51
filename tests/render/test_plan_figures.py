"""Floor plans: names where there is space, colours of neighbours apart, the same file twice."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from shapely.geometry import Point, Polygon

from mecp_env.floorplans import load_plan
from mecp_env.floorplans.exporters import save_map_server
from mecp_env.floorplans.plan_view import floor_plan
from mecp_env.render import palette
from mecp_env.render.plan_figures import plans_figure, save_plans
from mecp_env.world.config import GeneratorSpec
from mecp_env.world.generator import generate
from mecp_env.world.layout import load_layout, shipped_layouts
from mecp_env.world.outline import build_outline, obstacle_shape


@pytest.mark.parametrize("name", shipped_layouts())
def test_names_stand_in_their_rooms_clear_of_furniture_and_starts(name: str) -> None:
    layout = load_layout(name)
    blocks, starts = [obstacle_shape(obstacle) for obstacle in layout.obstacles], build_outline(layout).starts
    for room in floor_plan(layout).rooms:
        place = Point(room.label).buffer(0.45 * room.label_height_m)
        assert Polygon(room.ring).contains(place), room.name
        assert not any(block.intersects(place) for block in blocks), room.name
        assert min(np.linalg.norm(starts[:, :2] - room.label, axis=1)) > 0.3


def test_neighbours_have_different_colours() -> None:
    for seed in range(5):
        rooms = floor_plan(generate(GeneratorSpec.preset("hard"), seed)).rooms
        for a, b in itertools.combinations(rooms, 2):
            assert a.colour != b.colour or Polygon(a.ring).distance(Polygon(b.ring)) > 0.05


@pytest.mark.parametrize("turned_deg", [40.0, 130.0])
def test_names_in_narrow_turned_rooms_are_written_along_their_sides_and_never_upside_down(turned_deg: float) -> None:
    spec = GeneratorSpec.preset("medium", turned_deg=(turned_deg, turned_deg), corridor_width_m=(1.6, 1.6))
    rooms = floor_plan(generate(spec, 5)).rooms
    assert {round(room.label_turn_deg, 2) for room in rooms} == {0.0, 40.0, -50.0}
    assert next(room for room in rooms if room.name == "corridor 1").label_height_m > 0.5


def test_the_picture_shows_walls_floors_doors_furniture_and_starts(tmp_path: Path) -> None:
    layout = load_layout("furnished")
    save_map_server(layout, tmp_path / "map")
    for plan in (floor_plan(layout), floor_plan(load_plan(tmp_path / "map.yaml"))):
        save_plans([plan], tmp_path / "plan.png", dpi=80)
        with Image.open(tmp_path / "plan.png") as picture:
            pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3)
        for colour in (palette.SOLID, palette.DOOR, palette.ESTIMATE, *([(212, 200, 184)] if plan.obstacles else [])):
            assert (pixels == colour).all(axis=1).any(), colour
        assert 0.01 < (pixels == palette.SOLID).all(axis=1).mean() < 0.3
    assert any(len(shape) > 1 for shape in plan.walls)  # solid, with holes that leave the floor to be seen
    for ending in (".png", ".svg"):
        for name in ("a", "b"):
            save_plans([plan], tmp_path / f"{name}{ending}", dpi=30)
        assert (tmp_path / f"a{ending}").read_bytes() == (tmp_path / f"b{ending}").read_bytes()
    boxes = [axes.get_position() for axes in plans_figure([plan] * 5).axes]
    assert len(boxes) == 5
    assert all(box.x0 >= 0.0 and box.x1 <= 1.0 and box.y0 >= 0.0 and box.y1 <= 1.0 for box in boxes)


def test_the_areas_of_the_rooms_are_floor_and_together_all_of_it(tmp_path: Path) -> None:
    """A core that stands in a room, a ring of corridor round it, is no floor of it; nor are walls and furniture."""
    picture = np.zeros((200, 200), dtype=np.uint8)
    picture[10:190, 10:190] = 255
    picture[50:150, 50:150] = 0
    Image.fromarray(picture).save(tmp_path / "ring.png")
    ring, furnished = load_plan(tmp_path / "ring.png", resolution_m=0.05), load_layout("furnished")
    for plan in (floor_plan(furnished), floor_plan(ring)):
        assert sum(room.area_m2 for room in plan.rooms) == pytest.approx(plan.free_m2, abs=0.01)
    assert plan.free_m2 == pytest.approx(81.0 - 25.0, abs=0.5)
