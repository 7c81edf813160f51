"""Layouts: the included ones are as documented; wrong ones raise LayoutError with the field."""

import json
import math
import re
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

import pytest
from shapely.geometry import Polygon

from mecp_env.core.errors import LayoutError
from mecp_env.world.layout import Layout, load_layout, shipped_layouts
from mecp_env.world.outline import build_outline
from mecp_env.world.schema import BoxSpec
from tests.world.conftest import document_of
from tests.world.make import jambs_of

Document = dict[str, Any]


@pytest.mark.parametrize("name", shipped_layouts())
def test_json_both_ways(name: str, tmp_path: Path) -> None:
    layout, path = load_layout(name), tmp_path / "copy.json"
    path.write_text(layout.to_json())
    assert layout.name == name
    assert load_layout(path) == load_layout(str(path)) == load_layout(layout) == layout
    assert load_layout(json.loads(layout.to_json())) == layout
    path.write_text(layout.to_json(), encoding="utf-16")  # as the shell of Windows redirects
    assert load_layout(path) == layout
    lines = layout.to_json().splitlines()  # one wall a line
    assert sum(line.startswith('    {"points"') for line in lines) == len(layout.walls)
    assert max(map(len, lines)) < 200


def test_the_paper_layout_is_as_the_design_says() -> None:
    layout = load_layout("paper")
    assert Polygon(layout.walls[0].points).bounds == (0.0, 0.0, 20.0, 14.0)
    assert len(layout.rooms) >= 7
    assert sorted(len(room.polygon) for room in layout.rooms)[-2:] == [6, 8]  # an L and a T
    assert all(0.10 <= wall.thickness_m <= 0.15 for wall in layout.walls)
    assert {door.width_m for door in layout.doors} == {0.9}
    assert len(layout.doors) - len(layout.rooms) + 1 >= 2  # independent rings of rooms
    assert len([obstacle for obstacle in layout.obstacles if isinstance(obstacle, BoxSpec)]) == 3


def put(document: Document, path: str, value: Any) -> None:
    """Put `value` at `path`, such as "walls.1.thickness_m"."""
    *parents, last = (int(key) if key.isdigit() else key for key in path.split("."))
    reduce(getitem, parents, document)[last] = value


PILLAR = {"kind": "round", "centre": [5, 1.8], "radius_m": 0.3}
SCATTERED = [{"points": [[x, y], [x + 1, y]]} for x in range(-180, 0, 2) for y in range(0, 300, 3)]
BOW_TIE = [[0, 0], [5, 5], [5, 0], [0, 5]]
BAD_DOCUMENTS = {
    "number as text": ("walls.1.thickness_m", "0.1", r"walls\.1\.thickness_m.*'0\.1'"),
    "nan": ("walls.1.points.0.0", math.nan, r"walls\.1\.points\.0\.0.*nan"),
    "far away": ("walls.1.points.0", [5000, 0], r"walls\.1\.points\.0\.0.*1000.*5000"),
    "zero-length wall": ("walls.1.points", [[5, 0], [5, 0]], r"walls\.1.*0\.01 m apart"),
    "too many rooms": ("rooms", [{"name": "x", "polygon": BOW_TIE}] * 1001, "rooms: .*at most 1000"),
    "long name": ("rooms.0.name", "x" * 900_000, r"rooms\.0\.name: .*at most 80 characters"),
    "too many faces": ("walls", SCATTERED, r"36\d{3} faces, at most 20000 \(two for each point of a wall"),
    "walls in a heap": ("walls", [{"points": [[0, 0], [9, 5]]}] * 1000, r"walls: too many .* at most 1000000"),
    "later version": ("version", 2, r"version.*1.*2"),
    "same name twice": ("rooms.1.name", "west", r"rooms\.1\.name: 'west'"),
    "room not simple": ("rooms.0.polygon", BOW_TIE, r"rooms\.0\.polygon: not a simple polygon"),
    "rooms overlap": ("rooms.0.polygon.1", [5.5, 0], r"rooms\.1\.polygon: shares 1\.25 m2 with rooms\.0"),
    "door off its wall": ("doors.0.centre", [5.2, 1.8], r"doors\.0\.centre: \(5\.2, 1\.8\) is 0\.200 m off"),
    "door not square": ("doors.0.direction_deg", 30, r"doors\.0\.direction_deg: 30"),
    "door too wide": ("doors.0.width_m", 4.5, r"doors\.0\.width_m: 4\.5 .* at most 3\.600"),
    "door the wrong way": ("doors.0.direction_deg", 180, r"doors\.0\.centre.*not between its rooms"),
    "start in a wall": ("starts.0.point", [5.03, 4], r"starts\.0\.point: \(5\.03, 4\.0\) lies inside"),
    "start near a wall": ("starts.1.point", [8.8, 2], r"starts\.1\.point: .* 0\.125 m from a wall.*0\.22"),
    "walls not closed": ("walls.0.points", [[0, 0], [9, 0], [9, 5], [0, 5]], r"starts\.0\.point.*not closed"),
    "room without a door": ("doors", [], r"starts\.1\.point.*cut off|rooms\.1.*cannot be reached"),
    "narrow door": ("doors.0.width_m", 0.4, r"rooms\.1: 'east' cannot be reached by a radius of 0\.22 m"),
    "blocked door": ("obstacles", [PILLAR], r"rooms\.1: 'east' cannot be reached|doors\.0"),
    "tiny": ("rooms.0.polygon.1.0", 1.9e-230, "rooms"),  # a warning is an error here, too
    "key": ("strats", [], r"layout\.strats: no such field; did you mean 'starts'\? \(given: \[\]\)$"),
    "room": ("doors.0.rooms.0", "wets", r"doors\.0\.rooms\.0: no room is called 'wets'; .*'west'\?$"),
    "kind": ("obstacles", [{"kind": "boxx"}], r"obstacles\.0: .*mean 'box'\?"),
    "any length": ("doors.0.width_m", 10**5000, r"doors\.0\.width_m"),
}


@pytest.mark.parametrize("name", BAD_DOCUMENTS)
def test_bad_documents_are_refused_with_their_field(name: str, document: Document) -> None:
    path, value, message = BAD_DOCUMENTS[name]
    put(document, path, value)
    with pytest.raises(LayoutError, match=message):
        load_layout(document)


def test_bad_files_are_refused(tmp_path: Path) -> None:
    """Of what is wrong with JSON itself, tests/floorplans/test_plan_files.py has more."""
    path, cases = tmp_path / "bad.json", [(b" " * 2_000_001, "2000001 bytes, at most 2000000")]
    cases += [(b'{"walls": ' + b"[" * 40 + b"]" * 40 + b"}", r"walls\.0: "), (b"\xff\xfe\x00\x80", "no JSON")]
    cases += [(b'{"name": "\\ud800", "\\ud800": 1}', "unicode"), (b'{"version": ' + b"1" * 5000 + b"}", "no JSON")]
    for data, message in cases:
        path.write_bytes(data)
        with pytest.raises(LayoutError, match=rf"bad\.json.*{message}"):
            load_layout(path)


def test_two_doors_in_one_place_are_refused(document: Document) -> None:
    """Seen: a layout with a duplicate door was explored to the step limit, because one copy can never be found."""
    (door,) = document["doors"]
    (x, y), said = door["centre"], r"doors\.1\.centre: \[5\.0, .* m wide, touches the doorway of doors\.0"
    for other in (door, door | {"centre": [x, y + 0.9]}, door | {"width_m": 1.4}):
        with pytest.raises(LayoutError, match=said):
            load_layout(document | {"doors": [door, other]})
    assert len(load_layout(document | {"doors": [door, door | {"centre": [x, y + 1.0]}]}).doors) == 2


def test_what_is_no_layout_is_refused(tmp_path: Path) -> None:
    for given_name in ("", "a\0b", "x" * 5000, tmp_path, tmp_path / "none.json"):
        with pytest.raises(LayoutError, match=r"no such file; shipped layouts are furn.*two_rooms|cannot be read"):
            load_layout(given_name)
    with pytest.raises(LayoutError, match="did you mean 'two_rooms'"):
        load_layout("two_room")
    path = tmp_path / "layout.yaml"
    path.write_text(load_layout("two_rooms").to_json())
    with pytest.raises(LayoutError, match=r"ends in \.json, given '\.yaml'"):
        load_layout(path)
    for wrong in (None, b"paper", {1: 2}):
        with pytest.raises(LayoutError):
            load_layout(wrong)


@pytest.mark.parametrize("name", shipped_layouts())
def test_the_direction_of_a_cut_follows_from_its_wall(name: str) -> None:
    document, turned = document_of(name), document_of(name)
    for door, other in zip(document["doors"], turned["doors"], strict=True):
        del door["direction_deg"], other["direction_deg"]
        other["rooms"] = other["rooms"][::-1]
    there, back = load_layout(document), load_layout(turned)
    assert there == load_layout(name) == load_layout(json.loads(there.to_json()))
    for door, other in zip(there.doors, back.doors, strict=True):
        assert (door.heading - other.heading) % math.tau == pytest.approx(math.pi)


def solid_house() -> Document:
    """Two rooms of 4 x 3 m in one solid, the wall of 0.1 m between them with a gap of 0.9 m."""
    west = [[4, 1.9], [4, 3], [0, 3], [0, 0], [4, 0], [4, 1]]
    floor = [*west, [4.1, 1], [4.1, 0], [8.1, 0], [8.1, 3], [4.1, 3], [4.1, 1.9]]
    gap = {"centre": [4.05, 1.45], "width_m": 0.9, "rooms": ["west", "east"], "direction_deg": 0}
    return {
        "name": "solid",
        "solids": [{"outer": [[-1, -1], [9, -1], [9, 4], [-1, 4]], "holes": [floor]}],
        "walls": [],
        "rooms": [
            {"name": "west", "polygon": [[0, 0], [4.05, 0], [4.05, 3], [0, 3]]},
            {"name": "east", "polygon": [[4.05, 0], [8.1, 0], [8.1, 3], [4.05, 3]]},
        ],
        "doors": [gap | {"opening": "gap", "depth_m": 0.1}],
        "starts": [{"point": [2, 1.5]}],
    }


def test_solids_with_a_gap_are_as_good_as_walls_with_a_cut() -> None:
    layout = load_layout(solid_house())
    outline = build_outline(layout)
    assert (len(outline.segments), jambs_of(outline).sum()) == (12, 4)
    assert outline.doors.thickness == pytest.approx([0.1])
    assert outline.free_area.area == pytest.approx(24.09)
    assert load_layout(json.loads(layout.to_json())) == layout
    document = solid_house()
    put(document, "solids.0.holes.0.5", [4, 1.05])  # posts may be a little off
    put(document, "doors.0.width_m", 0.87)
    assert jambs_of(build_outline(load_layout(document))).sum() == 4


CUT = {"centre": [4.05, 1.45], "width_m": 0.9, "rooms": ["west", "east"], "direction_deg": 0, "opening": "cut"}
BAD_SOLIDS = {
    "crosses itself": ("solids.0.holes.0", BOW_TIE, r"solids\.0: not a simple polygon"),
    "nothing at all": ("solids", [], r"layout: walls: at least 1 expected"),
    "too many points": ("solids", [{"outer": [[0, 0], [1, 0], [1, 1]] * 4000}] * 2, r"rooms: 24\d{3} faces"),
    "gap without depth": ("doors.0.depth_m", None, r"doors\.0: .*a gap has depth_m"),
    "gap without direction": ("doors.0.direction_deg", None, r"doors\.0: .*a gap has direction_deg"),
    "cut without walls": ("doors.0", CUT, r"doors\.0\.opening: cut, but the layout has no walls"),
    "gap in a solid": ("doors.0.centre", [4.05, 2.4], r"doors\.0: 0\.\d\d of the gap is open, at least 0\.9"),
    "gap in the open": ("doors.0.width_m", 0.5, r"doors\.0\.width_m: an end is 0\.20 m from a wall, at most"),
    "gap the wrong way": ("doors.0.direction_deg", 180, r"doors\.0\.centre: .*not between its rooms"),
}


@pytest.mark.parametrize("name", BAD_SOLIDS)
def test_bad_solids_are_refused_with_their_field(name: str) -> None:
    document = solid_house()
    path, value, message = BAD_SOLIDS[name]
    put(document, path, value)
    with pytest.raises(LayoutError, match=message):
        load_layout(document)


def test_the_docs_name_every_field_with_its_bounds_and_their_layout_is_sound() -> None:
    page = (Path(__file__).parents[2] / "docs" / "layouts.md").read_text()
    layout = load_layout(json.loads(page.partition("```json\n")[2].partition("```")[0]))
    assert (len(layout.rooms), len(layout.doors), len(layout.obstacles)) == (2, 1, 3)
    text = page.replace(",", "")
    schema = Layout.model_json_schema()
    for part in (schema, *schema["$defs"].values()):
        for name, field in part["properties"].items():
            assert re.search(rf"[`.\]]{name}[`\[]", text), name
            bounds = [field.get(key) for key in ("minimum", "maximum", "maxItems", "maxLength") if field.get(key)]
            assert all(f"{bound:g}" in text for bound in bounds if bound < 1e5), (name, bounds)
