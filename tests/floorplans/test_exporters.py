"""Files for other programs: readable map_server pairs, valid SVG."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import shapely
import yaml
from PIL import Image

from mecp_env.core.errors import LayoutError
from mecp_env.floorplans import load_plan
from mecp_env.floorplans.exporters import FREE, OCCUPIED, UNKNOWN, save_map_server, save_svg
from mecp_env.slam.messages import Cell, SemanticGrid
from mecp_env.world.layout import load_layout
from mecp_env.world.outline import build_outline
from tests.slam import make


def believed() -> SemanticGrid:
    """Two rooms of 3 x 4 m as estimated by a robot, and a corner that it has not seen."""
    label = np.full((50, 80), int(Cell.UNKNOWN), dtype=np.uint8)
    label[4:46, 4:76] = int(Cell.OCCUPIED)
    label[5:45, 5:35] = int(Cell.FREE)
    label[5:45, 37:75] = int(Cell.FREE)
    label[20:29, 35:37] = int(Cell.DOOR)
    label[40:45, 5:10] = int(Cell.UNKNOWN)
    room = np.full((50, 80), -1, dtype=np.int16)
    room[:, :36], room[:, 36:] = 0, 1
    return make.grid(label, room, origin=(-3.0, 2.0))


def test_a_layout_is_drawn_where_it_stands(tmp_path: Path) -> None:
    layout = load_layout("furnished")
    free_area = build_outline(layout).free_area
    sheet, image = save_map_server(layout, tmp_path / "out.d", 0.04)
    assert (sheet.name, image.name) == ("out.d.yaml", "out.d.pgm")
    fields = dict(line.split(": ") for line in sheet.read_text().splitlines())
    assert fields["image"] == "out.d.pgm"
    x0, y0, yaw = (float(value) for value in fields["origin"].strip("[]").split(", "))
    levels = np.asarray(Image.open(image))[::-1]
    rows, columns = np.indices(levels.shape)
    inside = shapely.contains_xy(free_area, x0 + 0.04 * (columns + 0.5), y0 + 0.04 * (rows + 0.5))
    assert yaw == 0.0
    assert np.array_equal(levels == FREE, inside)
    assert set(np.unique(levels)) == {OCCUPIED, UNKNOWN, FREE}
    assert (levels[[0, -1]] != FREE).all()


def test_a_believed_map_can_be_read_as_a_plan(tmp_path: Path) -> None:
    grid = believed()
    sheet, image = save_map_server(grid, tmp_path / "belief")
    levels = np.asarray(Image.open(image))[::-1]
    assert np.array_equal(levels == FREE, (grid.label == int(Cell.FREE)) | (grid.label == int(Cell.DOOR)))
    assert np.array_equal(levels == OCCUPIED, grid.label == int(Cell.OCCUPIED))
    layout = load_plan(sheet)
    (door,) = layout.doors
    assert len(layout.rooms) == 2
    assert (*door.centre, door.width_m) == pytest.approx((0.6, 4.45, 0.9), abs=0.06)


def drawn(given: Any, folder: Path) -> tuple[ET.Element, list[str | None]]:
    """A drawing, which is well formed and not large, and its titles."""
    path = save_svg(given, folder / "plan.svg")
    root = ET.parse(path).getroot()
    assert root.tag.endswith("svg")
    assert path.stat().st_size < 200_000
    return root, [title.text for title in root.iter("{http://www.w3.org/2000/svg}title")]


def test_drawings_are_well_formed_and_name_rooms_and_doors(tmp_path: Path) -> None:
    for given in (believed(), load_layout("paper")):
        assert len(list(drawn(given, tmp_path)[0].iter())) > 20
    named = load_layout("two_rooms").model_copy(update={"name": "<b>"})
    assert drawn(named, tmp_path)[1] == ["west", "east", "door of west and east"]
    controls = json.loads(load_layout("two_rooms").to_json().replace("west", "w\\u0007\\u001b]0;a\\u0007"))
    assert drawn(load_layout(controls), tmp_path)[1] == ["w??]0;a?", "east", "door of w??]0;a? and east"]


@pytest.mark.parametrize("stem", ["a: b", "x #1", "[map]", 'a"b', "部屋", "-"])
def test_the_image_may_have_any_name(stem: str, tmp_path: Path) -> None:
    sheet, image = save_map_server(load_layout("two_rooms"), tmp_path / stem, 0.1)
    assert yaml.safe_load(sheet.read_text())["image"] == image.name


@pytest.mark.parametrize("resolution_m", [0.0, -1.0, 2.0, float("nan"), 0.0001])
def test_a_resolution_out_of_bounds_is_refused(resolution_m: float, tmp_path: Path) -> None:
    with pytest.raises(LayoutError, match=r"resolution_m"):
        save_map_server(load_layout("paper"), tmp_path / "map", resolution_m)
