"""Real floor plans: rooms and doors are those that a person would draw."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from PIL import Image
from shapely.geometry import Point, Polygon

from mecp_env.core.errors import ConfigError, LayoutError, PlanWarning
from mecp_env.floorplans import load_plan
from mecp_env.floorplans.straighten import directions, straightened
from mecp_env.world.layout import Layout, load_layout
from mecp_env.world.outline import build_outline
from mecp_env.world.schema import Pillar
from tests.floorplans import plans
from tests.floorplans.plans import RESOLUTION_M
from tests.world.make import jambs_of

REAL_PLANS = {  # rooms and doors by eye
    "houseexpo/0a1b29dba355df2ab02630133187bfab.json": (7, 6),
    "ros_map/skirk.yaml": (1, 0),
    "ros_map/stata_basement.yaml": (3, 2),
    "dungeon/1.png": (1, 0),
    "dungeon/10.png": (1, 0),
    "dungeon/100.png": (1, 0),
}


def read(picture: plans.Picture, folder: Path, **options: Any) -> Layout:
    return load_plan(plans.save(picture, folder / "plan.png"), resolution_m=RESOLUTION_M, **options)


def test_two_rooms_and_their_door(tmp_path: Path) -> None:
    layout = read(plans.two_rooms_picture(), tmp_path, free_above=210)
    assert [len(room.polygon) for room in layout.rooms] == [8, 8]  # four corners and half a doorway
    (door,) = layout.doors
    assert door.centre == pytest.approx(plans.DOOR_M, abs=0.03)
    assert (door.width_m, door.depth_m) == pytest.approx((0.9, 0.1), abs=0.04)
    assert (door.direction_deg + 90.0) % 180.0 == pytest.approx(90.0, abs=0.01)
    outline = build_outline(layout)
    assert len(outline.segments) == 12
    assert np.array_equal(jambs_of(outline)[0], outline.corners.convex)
    assert outline.free_area.area == pytest.approx(40.0 + 0.09, abs=0.02)
    assert len(layout.starts) == 2
    ends_in_floor = read(plans.two_rooms_picture()[:, 40:], tmp_path, free_above=210)  # is closed
    assert (len(ends_in_floor.rooms), len(ends_in_floor.doors)) == (2, 1)


def test_a_corridor_has_doors_to_rooms_only(tmp_path: Path) -> None:
    """No door round its corner, at the alcove, between the pillar and the walls."""
    layout = read(plans.corridor_picture(), tmp_path)
    assert (len(layout.rooms), len(layout.doors)) == (4, 3)
    assert all(door.width_m == pytest.approx(0.9, abs=0.06) for door in layout.doors)
    assert jambs_of(build_outline(layout)).sum() == 12
    corridor = Polygon(layout.rooms[0].polygon)
    assert corridor.contains(Point(9.5, 3.0))
    assert corridor.contains(Point(2.0, 5.2))


@pytest.mark.parametrize("turn", [0.0, 25.0])
def test_doors_in_double_walls_beside_partitions_and_in_frames(turn: float, tmp_path: Path) -> None:
    """Seen: 6 rooms and 6 doors; the corridor and two rooms were one, and the last room was lost."""
    path = plans.map_pair(tmp_path, plans.office_picture(), origin=[0.0, 0.0, math.radians(turn)])
    layout = load_plan(path)
    assert (len(layout.rooms), len(layout.doors)) == (9, 9)
    assert not layout.obstacles  # the piece of wall between two doors is none
    doors = sorted((d.width_m, d.depth_m or 0.0) for d in layout.doors)
    assert doors[0] == pytest.approx((0.6, 0.15), abs=0.03)  # 0.4 m in the picture
    assert doors[-1] == pytest.approx((1.4, 0.1), abs=0.05)  # between the posts of the frame
    assert sum(depth == pytest.approx(0.6, abs=0.03) for _, depth in doors) == 5
    with pytest.warns(PlanWarning, match="wide enough"):  # narrow doors are not widened where they are excluded
        layout = load_plan(path, door_width_m=(0.6, 1.9))
    assert (len(layout.rooms), len(layout.doors)) == (8, 8)


@pytest.mark.parametrize("turn", [7.0, 60.0])
def test_a_turned_plan_is_the_same_plan(turn: float, tmp_path: Path) -> None:
    path = plans.map_pair(tmp_path, plans.two_rooms_picture(), origin=[3.0, -2.0, math.radians(turn)])
    layout = load_plan(path)
    (door,) = layout.doors
    cos, sin = math.cos(math.radians(turn)), math.sin(math.radians(turn))
    x, y = plans.DOOR_M
    assert door.centre == pytest.approx((3.0 + cos * x - sin * y, -2.0 + sin * x + cos * y), abs=0.03)
    assert (door.direction_deg - turn + 90.0) % 180.0 == pytest.approx(90.0, abs=0.1)
    assert len(build_outline(layout).segments) == 12


LEVELS = {  # wall, floor, unknown, and the fields that make it so
    "trinary": (0, 254, 205, {}),
    "negate": (255, 1, 50, {"negate": 1}),
    "scale": (0, 254, 120, {"mode": "scale"}),
    "graded": (10, 200, 110, {"mode": "scale", "free_thresh": 0.1, "occupied_thresh": 0.9}),
    "raw": (100, 0, 255, {"mode": "raw"}),
    "truth values": (0, 254, 205, {"negate": False, "free_thresh": 0.25, "occupied_thresh": None, "mode": None}),
    "plane origin": (0, 254, 205, {"origin": [0, 0]}),
    "any case, as in nav2": (0, 254, 205, {"mode": "Trinary"}),
}


@pytest.mark.filterwarnings("ignore::mecp_env.core.errors.PlanWarning")
@pytest.mark.parametrize("name", LEVELS)
def test_the_modes_of_map_server(name: str, tmp_path: Path) -> None:
    wall, floor, unknown, fields = LEVELS[name]
    table = np.zeros(256, dtype=np.uint8)
    table[[0, 254, 205]] = wall, floor, unknown
    expected = read(plans.two_rooms_picture(), tmp_path, free_above=210)
    layout = load_plan(plans.map_pair(tmp_path, table[plans.two_rooms_picture()], **fields))
    assert (layout.rooms, layout.doors, layout.solids) == (expected.rooms, expected.doors, expected.solids)


def test_what_cannot_be_reached_is_dropped(tmp_path: Path) -> None:
    picture = plans.two_rooms_picture()
    picture[62:80, 92:94] = 0
    picture[62:66, 92:94] = 254  # 0.2 m: too narrow for the robot
    with pytest.warns(PlanWarning, match=r"leads to: 1, of 20\.0 m2"):
        layout = read(picture, tmp_path, free_above=210)
    assert len(layout.rooms) == 1
    assert build_outline(layout).free_area.area == pytest.approx(20.0, abs=0.1)
    assert "no wide enough doorway leads to: 1, of 20.0 m2" in layout.description


def house_file(folder: Path, **changes: Any) -> Path:
    path = folder / "house.json"
    path.write_text(json.dumps(plans.house() | changes))
    return path


def test_a_house_of_fingers_and_stairs(tmp_path: Path) -> None:
    layout = load_plan(house_file(tmp_path))
    assert {room.name for room in layout.rooms} == {"Bed Room", "Kitchen", "Hall"}
    doors = {frozenset(door.rooms): door for door in layout.doors}
    assert set(doors) == {frozenset({"Bed Room", "Kitchen"}), frozenset({"Kitchen", "Hall"})}
    below, beside = doors[frozenset({"Bed Room", "Kitchen"})], doors[frozenset({"Kitchen", "Hall"})]
    assert (*below.centre, below.width_m) == pytest.approx((2.45, 3.06, 0.9), abs=0.02)
    assert (*beside.centre, beside.width_m) == pytest.approx((4.0, 3.95, 0.9), abs=0.02)
    outline = build_outline(layout)
    assert jambs_of(outline).sum() == 8
    assert len(outline.segments) == 22
    assert outline.free_area.area == pytest.approx(Polygon(plans.house()["verts"]).area, abs=0.1)
    layout = load_plan(house_file(tmp_path, room_category={"Room": [[3.5, -1, 9, 7]]}))  # boxes say little
    assert sorted(room.name for room in layout.rooms) == ["Room", "room 2", "room 3"]


@pytest.mark.slow
def test_a_large_clean_plan_is_counted_by_its_corners(tmp_path: Path) -> None:
    """Rooms of 8 m in 96 x 96 m: 89,000 vertices at the pixels, few corners. Seen: refused as more than 50,000."""
    picture = np.full((1923, 1923), 255, dtype=np.uint8)
    walls = range(0, 1923, 160)
    for first in walls:
        picture[first : first + 3] = picture[:, first : first + 3] = 0
    for first in walls[1:-1]:
        for middle in range(70, 1923, 160):
            picture[first : first + 3, middle : middle + 18] = picture[middle : middle + 18, first : first + 3] = 255
    layout = read(picture, tmp_path)
    assert (len(layout.rooms), len(layout.doors)) == (144, 264)


def test_labelled_rooms_and_doors(tmp_path: Path) -> None:
    """A door line is always a door, even with an opening 3 m wide."""
    layout = read(plans.labelled_picture(), tmp_path, kind="labelled")
    assert (len(layout.rooms), len(layout.doors)) == (3, 2)
    assert sorted(door.width_m for door in layout.doors) == pytest.approx([0.9, 3.0], abs=0.03)


def test_a_labelled_room_that_nobody_can_enter_is_named(tmp_path: Path) -> None:
    """Seen: a room without a door was omitted silently. A room behind a door that is too narrow is named too."""
    closed, narrow = plans.labelled_picture(), plans.labelled_picture()
    closed[32:92, 174:176] = 0
    narrow[32:92, 174:176] = 0
    narrow[60:64, 174:176] = 255
    for picture in (closed, narrow):
        with pytest.raises(LayoutError, match=r"image: the room at column \d+, row \d+ is lost") as caught:
            read(picture, tmp_path, kind="labelled")
        column, row = (int(word.strip(",")) for word in str(caught.value).split() if word.strip(",").isdigit())
        assert tuple(picture[row, column]) == (30, 30, 200)


def test_a_ring_of_corridor_round_a_core(tmp_path: Path) -> None:
    """A room inside of another: the outer one is a ring with a slit, and the two do not overlap."""
    picture = np.zeros((200, 200), dtype=np.uint8)
    picture[10:190, 10:190] = 255
    picture[50:150, 50:150] = 0
    picture[53:147, 53:147] = 255
    picture[90:108, 50:53] = 255
    layout = read(picture, tmp_path)
    assert (len(layout.rooms), len(layout.doors)) == (2, 1)


def test_stairs_become_a_slope_and_noise_on_the_walls_goes() -> None:
    area = straightened(Polygon([*plans.stairs((0.0, 0.0), (3.0, 2.0)), (6.0, 2.0), (6.0, -3.0), (0.0, -3.0)]), 0.03)
    assert len(area.exterior.coords) == 6
    assert area.exterior.hausdorff_distance(Polygon([(0, 0), (3, 2), (6, 2), (6, -3), (0, -3)]).exterior) < 0.03
    rng = np.random.default_rng(5)
    ring = np.array(shapely.segmentize(Polygon([(0, 0), (8, 0), (8, 5), (3, 5), (3, 3), (0, 3)]).exterior, 0.1).coords)
    turned = shapely.affinity.rotate(Polygon(ring[:-1] + rng.normal(0.0, 0.012, (len(ring) - 1, 2))), 20.0, (0, 0))
    area = straightened(turned, 0.06)
    assert directions(area)[0] == pytest.approx(math.radians(20.0), abs=0.003)
    assert len(area.exterior.coords) == 7
    corners = np.diff(np.array(area.exterior.coords), axis=0)
    angles = np.degrees(np.arctan2(corners[:, 1], corners[:, 0])) - math.degrees(directions(area)[0])
    assert np.abs((angles + 45.0) % 90.0 - 45.0).max() < 1e-6


def test_where_a_ring_begins_makes_no_corner() -> None:
    """The blurred end of a wall of 0.13 m between two rooms, with the ring begun at any of its points."""
    end = [(2.0, 1.5), (2.02, 1.44), (2.08, 1.43), (2.13, 1.46)]
    ring = [(2.0, 3.0), *end, (2.13, 3.0), (5.0, 3.0), (5.0, 0.0), (2.5, 0.0), (0.0, 0.0), (0.0, 1.0), (0.0, 3.0)]
    for start in range(12):
        area = straightened(Polygon(ring[start:] + ring[:start]), 0.06)
        assert len(area.exterior.coords) - 1 == 8
        assert area.bounds == pytest.approx((0.0, 0.0, 5.0, 3.0), abs=0.03)


@plans.needs_real
@pytest.mark.parametrize("name", REAL_PLANS)
def test_real_plans_are_read_as_a_person_would(name: str) -> None:
    layout = load_plan(plans.real(name), resolution_m=RESOLUTION_M)
    assert (len(layout.rooms), len(layout.doors)) == REAL_PLANS[name]
    outline = build_outline(layout)
    assert len(outline.segments) <= 500
    assert len(layout.to_json()) < 100_000
    assert load_layout(json.loads(layout.to_json())) == layout
    assert outline.free_area.boundary.distance(Point(layout.starts[0].point)) > 0.9
    if len(layout.doors) == 6:
        assert jambs_of(outline).sum(axis=1).tolist() == [4] * 6
        widths = sorted(door.width_m for door in layout.doors)
        assert widths == pytest.approx([0.71, 1.0, 1.0, 1.15, 1.2, 1.84], abs=0.03)
        assert {"Kitchen", "Gym", "Bedroom", "Bedroom 2"} <= {room.name for room in layout.rooms}


def test_a_grey_level_between_wall_and_floor_is_named(tmp_path: Path) -> None:
    """Seen: a picture with grey unknown was read as one room that covered all of it, without a warning."""
    path = plans.save(np.pad(plans.two_rooms_picture(), 40, constant_values=205), tmp_path / "plan.png")
    with pytest.warns(PlanWarning, match=r"plan\.png.*grey 205 on \d+ % of the picture.* read as floor.*free_above"):
        covered = load_plan(path, resolution_m=0.05)
    assert "Grey 205" in covered.description
    layout = load_plan(path, resolution_m=0.05, free_above=230)
    assert (len(layout.rooms), len(layout.doors)) == (2, 1)
    dark = np.where(plans.two_rooms_picture() == 205, 60, plans.two_rooms_picture()).astype(np.uint8)
    with pytest.warns(PlanWarning, match="grey 60 .* read as wall"):
        assert len(load_plan(plans.save(dark, path), resolution_m=0.05).rooms) == 2


def test_wrong_options_are_named(tmp_path: Path) -> None:
    path, scale = plans.save(plans.two_rooms_picture(), tmp_path / "plan.png"), {"resolution_m": 0.05}
    wrong: list[tuple[type[Exception], dict[str, Any], str]] = [
        (ConfigError, {"resolution_m": 0.0}, r"resolution_m.*0\.005"),
        (ConfigError, scale | {"colour": "red"}, "colour"),
        (ConfigError, scale | {"door_width_m": (1.0, 0.5)}, r"door_width_m"),
        (LayoutError, {}, r"plan\.png: resolution_m: missing"),
    ]
    for kind, options, said in wrong:
        with pytest.raises(kind, match=said):
            load_plan(path, **options)


@pytest.mark.parametrize("turn", [0, 20, 45])
def test_a_box_is_no_pillar(turn: int, tmp_path: Path) -> None:
    square = np.full((120, 120), 255, dtype=np.uint8)
    square[52:67, 52:67] = 0
    turned = np.asarray(Image.fromarray(square).rotate(turn, fillcolor=255))
    assert not any(isinstance(o, Pillar) for o in read(turned, tmp_path, free_above=100).obstacles)
