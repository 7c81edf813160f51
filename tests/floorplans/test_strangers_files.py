"""Plans as strangers have them: maps of nav2, paths of other machines, other files in the folder, large floors."""

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from mecp_env.core.errors import LayoutError, PlanWarning
from mecp_env.floorplans import load_plan, plan_files
from mecp_env.floorplans.folder import left_out
from mecp_env.floorplans.image import read_image
from mecp_env.floorplans.vectorise import Placement, floor_polygon
from tests.floorplans import plans


def pair(folder: Path, **fields: Any) -> Path:
    return plans.map_pair(folder, plans.two_rooms_picture(), **fields)


def test_unknown_of_nav2_is_not_floor(tmp_path: Path) -> None:
    with pytest.warns(PlanWarning, match="205"):
        layout = load_plan(pair(tmp_path, free_thresh=0.25))
    assert layout.rooms == load_plan(pair(tmp_path, free_thresh=0.196)).rooms


@pytest.mark.parametrize(
    ("there", "written", "said"),
    [
        ("map.pgm", "maps/map.pgm", "beside the yaml"),
        ("map.pgm", "../map.pgm", "is not there, or not in this folder"),
        ("map.pgm", "/maps/robot/map.pgm", "beside the yaml"),
        ("map.pgm", r"C:\\maps\\map.pgm", "beside the yaml"),
        ("MAP.PGM", "map.pgm", r"MAP\.PGM"),
        ("maps/map.pgm", r"Maps\\map.pgm", r"'maps/map\.pgm' beside"),
    ],
)
def test_an_image_that_is_elsewhere_than_the_yaml_says(there: str, written: str, said: str, tmp_path: Path) -> None:
    path = pair(tmp_path)
    (tmp_path / "maps").mkdir()
    (tmp_path / "map.pgm").rename(tmp_path / there)
    path.write_text(path.read_text().replace("map.pgm", written))
    with pytest.warns(PlanWarning, match=said):
        assert len(load_plan(path).rooms) == 2
    (tmp_path / there).rename(tmp_path / "map2.pgm")
    with pytest.raises(LayoutError, match=r"image: .*did you mean 'map2\.pgm'"):
        load_plan(path)


@pytest.mark.parametrize("fields", [{"origin": [451e3, 5.4e6, 0.0]}, {"resolution": 50.0}, {"free_thresh": 25}])
def test_a_wrong_field_of_a_map_comes_with_what_is_expected(fields: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(LayoutError, match=r"given: .*; expected .* m per pixel, origin .* 0 will do.* from 0 to 1"):
        load_plan(pair(tmp_path, **fields))


@pytest.mark.parametrize("ending", ["bmp", "tif"])
def test_bitmaps_that_pillow_reads(ending: str, tmp_path: Path) -> None:
    path = pair(tmp_path)
    expected = load_plan(path)
    Image.open(tmp_path / "map.pgm").save(tmp_path / f"map.{ending}")
    path.write_text(path.read_text().replace("map.pgm", f"map.{ending}"))
    assert load_plan(path).rooms == expected.rooms


def test_a_folder_leaves_out_what_is_no_plan(tmp_path: Path) -> None:
    path = pair(tmp_path)
    (tmp_path / "params.yaml").write_text("amcl:\n  ros__parameters: {}\n")
    (tmp_path / "settings.json").write_text(json.dumps({"a": 1}))
    with pytest.warns(PlanWarning, match="2 other files"):
        assert plan_files(tmp_path) == (path,)
    assert sorted(p.name for p in left_out(tmp_path)) == ["params.yaml", "settings.json"]


def test_numbers_without_a_point_are_numbers_in_a_map(tmp_path: Path) -> None:
    path = pair(tmp_path, origin=[-10.0, -0.00001, 0.0])
    expected = load_plan(path)
    path.write_text(path.read_text().replace("[-10.0, -1e-05, 0.0]", "[-1E+1, -1e-05, 0e0]"))
    assert "-1E+1" in path.read_text()
    assert load_plan(path) == expected


def in_a_margin(margin: int) -> plans.Picture:
    """Two rooms of 10 x 7.5 m, and floor around them."""
    free = np.ones((200 + 2 * margin, 300 + 2 * margin), np.bool_)
    house = free[margin : margin + 200, margin : margin + 300]
    house[:3], house[-3:], house[:, :3], house[:, -3:], house[:, 150:153] = False, False, False, False, False
    return free


def in_a_frame() -> plans.Picture:
    """A building with a wall through it, on a sheet within its frame."""
    free = np.zeros((120, 120), np.bool_)
    free[2:-2, 2:-2] = True
    free[14:-14, 14:-14] = False
    free[15:-15, 15:-15] = True
    free[60] &= ~((np.arange(120) > 13) & (np.arange(120) < 106))
    return free


FLOORS = {
    "outside": in_a_margin(60),
    "left out: 1, of 70 m2": in_a_margin(0),
    "swap black and white": np.pad(np.zeros((80, 80), np.bool_), 20, constant_values=True),  # seen: a ring of floor
    "frame": in_a_frame(),
}


@pytest.mark.parametrize("said", FLOORS)
def test_a_floor_that_is_not_the_building_is_told(said: str) -> None:
    with pytest.warns(PlanWarning, match=said):
        floor_polygon(FLOORS[said], Placement(0.05))
    with warnings.catch_warnings(action="error"):
        floor_polygon(np.pad(plans.two_rooms_picture() == 254, 20), Placement(0.05))


def test_walls_of_one_pixel_stay_where_pixels_are_joined() -> None:
    free = np.zeros((2200, 2200), np.bool_)
    free[10:-10, 10:-10] = True
    free[1000, 10:2000] = False
    with pytest.warns(PlanWarning, match="2 x 2"):
        area = floor_polygon(free, Placement(0.01))
    free[1000, :] = False
    with pytest.warns(PlanWarning, match="2 x 2"):
        half = floor_polygon(free, Placement(0.01), told=True)
    assert area.area > 1.9 * half.area * 0.9
    assert half.bounds[3] - half.bounds[1] < 12.1


@pytest.mark.parametrize("fields", [{"negate": 1}, {"mode": "raw"}])
def test_marks_of_a_map_saver_with_other_fields_are_told(fields: dict[str, Any], tmp_path: Path) -> None:
    path = plans.map_pair(tmp_path, np.repeat(np.repeat(plans.two_rooms_picture(), 6, 0), 6, 1), **fields)
    with warnings.catch_warnings(record=True, action="always") as found:
        load_plan(path)
    assert "greys as map_saver saves" in str(found[0].message)


def test_negate_means_nothing_in_the_mode_raw(tmp_path: Path) -> None:
    table = np.zeros(256, dtype=np.uint8)
    table[[0, 254, 205]] = 100, 0, 255
    picture = table[plans.two_rooms_picture()]
    expected = load_plan(plans.map_pair(tmp_path, picture, mode="raw"))
    with pytest.warns(PlanWarning, match="negate"):
        assert load_plan(plans.map_pair(tmp_path, picture, mode="raw", negate=1)).rooms == expected.rooms


def test_a_scale_that_is_not_in_metres_is_told(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(json.dumps({"verts": [[0, 0], [400, 0], [400, 300], [0, 300]]}))
    with pytest.warns(PlanWarning, match="120000 m2 of floor and 1 room; check that its scale"):
        load_plan(tmp_path / "a.json")


def test_dust_of_a_laser_is_erased(tmp_path: Path) -> None:
    picture = np.kron(plans.two_rooms_picture(), np.ones((6, 6), np.uint8))
    picture[np.random.default_rng(0).random(picture.shape) < 0.05] = 205
    assert len(load_plan(plans.map_pair(tmp_path, picture, resolution=plans.RESOLUTION_M / 6)).rooms) == 2


@pytest.mark.parametrize("name", ["a.tif", "a.png"])
def test_of_several_pictures_the_first_is_read_with_a_warning(name: str, tmp_path: Path) -> None:
    image = Image.fromarray(plans.two_rooms_picture())
    image.save(tmp_path / name, save_all=True, append_images=[image.rotate(180)])
    with pytest.warns(PlanWarning, match="the first"):
        assert read_image(tmp_path / name).size == image.size


def test_pixels_that_are_more_opaque_than_not_count(tmp_path: Path) -> None:
    picture = plans.two_rooms_picture()
    for alpha in (254, 200, 0):
        path = plans.save(np.dstack([picture, np.full_like(picture, alpha)]), tmp_path / "a.png")
        if alpha:
            assert len(load_plan(path, resolution_m=plans.RESOLUTION_M, free_above=210).rooms) == 2
        else:
            with pytest.raises(LayoutError):
                load_plan(path, resolution_m=plans.RESOLUTION_M, free_above=210)


def test_a_floor_of_one_colour_on_a_transparent_ground(tmp_path: Path) -> None:
    floor = np.where(plans.two_rooms_picture() > 210, 255, 0).astype(np.uint8)
    path = plans.save(np.dstack([np.full_like(floor, 255), floor]), tmp_path / "a.png")
    assert len(load_plan(path, resolution_m=plans.RESOLUTION_M).rooms) == 2
    path = plans.save(np.dstack([np.zeros_like(floor), 255 - floor]), tmp_path / "a.png")
    with pytest.raises(LayoutError, match="save it on a white one"):
        load_plan(path, resolution_m=plans.RESOLUTION_M)


@pytest.mark.parametrize(("old", "new"), [(": ", ":\t"), ("\n", "\r\n"), ("- ", "\t- ")])
def test_tabs_and_line_ends_in_a_yaml(old: str, new: str, tmp_path: Path) -> None:
    path = pair(tmp_path)
    expected, text = load_plan(path), path.read_text()
    path.write_bytes(text.replace(old, new).encode())
    assert len(load_plan(path).rooms) == len(expected.rooms)
