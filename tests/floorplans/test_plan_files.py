"""Untrusted plan files: any content gives a layout or one clear LayoutError with the file, within the limits."""

import json
import struct
import time
import zlib
from io import BytesIO
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from mecp_env.core.errors import LayoutError
from mecp_env.floorplans import load_plan
from tests.floorplans import plans
from tests.floorplans.plans import MEGABYTES, SECONDS
from tests.processes import costs, needs_linux

pytestmark = pytest.mark.filterwarnings("ignore::mecp_env.core.errors.PlanWarning")


def png(width: int, height: int, data: bytes, colour: int = 0, bits: int = 8) -> bytes:
    """A PNG file that claims to be of a size; colour 0 is grey, 6 is RGBA."""
    header = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    parts = ((b"IHDR", header), (b"IDAT", data), (b"IEND", b""))
    chunks = (struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in parts)
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def house(**changes: Any) -> bytes:
    return json.dumps(plans.house() | changes).encode()


def sheet(**fields: str) -> bytes:
    """A map_server yaml for the image map.pgm beside it, with some fields as they are given."""
    given = {"image": "map.pgm", "resolution": "0.05", "origin": "[0, 0, 0]"} | fields
    return "".join(f"{key}: {value}\n" for key, value in given.items()).encode()


def encoded(picture: np.ndarray[Any, Any], kind: str = "PNG", **options: Any) -> bytes:
    """A picture as a file of an image format."""
    file = BytesIO()
    Image.fromarray(picture).save(file, kind, **options)
    return file.getvalue()


def noise(size: int, share: float) -> np.ndarray[Any, Any]:
    return ((np.random.default_rng(0).random((size, size)) > share) * 255).astype(np.uint8)


TWO_ROOMS, SOUND_PNG = plans.two_rooms_picture(), encoded(plans.two_rooms_picture())
FLOOR = np.where(TWO_ROOMS == 254, 255, 0).astype(np.uint8)
ZEROS = zlib.compress(bytes(1000))
OTHER_JSON = r"JSON of another kind; read are .*HouseExpo"
STAR = [[float((50 + 20 * (i % 2)) * f(i / 1500)) for f in (np.cos, np.sin)] for i in range(9000)]
BAD: dict[str, tuple[str, bytes, str]] = {
    "wrong ending": ("plan.txt", b"", r"no plan by its ending, '\.txt'; read are .*PNG"),
    "nothing in it": ("plan.json", b"", r"no JSON"),
    "a key twice": ("plan.json", b'{"verts": [], "verts": []}', r"verts: given twice"),
    "no points": ("plan.json", house(verts=[]), r"verts: .*at least 3 items"),
    "nan": ("plan.json", house(verts=[[0, 0], [1, 0], [1, float("nan")]]), r"verts\.2\.1: .*finite number.*nan"),
    "far away": ("plan.json", house(verts=[[0, 0], [1e5, 0], [1, 1]]), r"verts\.1\.0: .*equal to 1000.*100000"),
    "crosses itself": ("plan.json", house(verts=[[0, 0], [5, 5], [5, 0], [0, 5]]), r"not a simple .*Self-inter"),
    "a narrow slot": ("plan.json", house(verts=[[0, 0], [9, 0], [9, 0.3], [0, 0.3]]), r"no floor is wide enough"),
    "a star": ("plan.json", house(verts=STAR), r"vertices even|not a simple"),
    "box of three": ("plan.json", house(room_category={"a": [[0, 0, 1]]}), r"room_category\.a\.0\.3: Field required"),
    "too many boxes": ("plan.json", house(room_category={"a": [[0, 0, 1, 1]] * 501}), r"501 boxes, at most 500"),
    "image of 100,000 a side": ("plan.png", png(100_000, 100_000, ZEROS), r"image: .*at most 16777216 pixels"),
    "pixmap of 20,000 a side": ("plan.pgm", b"P5 20000 20000 255\n", r"at most 16777216 .*scale it down, and give"),
    "more pixels": ("plan.pgm", b"P5 10 10 255\n" + bytes(5000), r"more than 100 bytes of pixels, 100 .*10 x 10"),
    "rows behind the last": ("plan.png", png(10, 5, zlib.compress(bytes(110))), "more than 55 bytes of pixels, 55 exp"),
    "header that lies": ("plan.png", png(4000, 4000, ZEROS), r"image: .* bytes of pixels, 16\d+ expected"),
    "decompression bomb": ("plan.png", png(4096, 4096, zlib.compress(bytes(4096 * 16385), 9), 6), r"one grey level"),
    "16 bits a pixel": ("plan.png", png(3, 1, zlib.compress(bytes(7)), 0, 16), r"image: .*mode I"),
    "other image format": ("plan.png", b"GIF89a" + bytes(50), r"image: .*GIF picture"),
    "JPEG": ("plan.png", encoded(TWO_ROOMS, "JPEG"), r"JPEG.*save it as a PNG"),
    "pointer of Git LFS": ("plan.pgm", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "git lfs pull"),
    "floor is transparent": ("plan.png", encoded(FLOOR, transparency=255), "no pixel is floor; check"),
    "cut": ("plan.png", SOUND_PNG[:-12], "truncated: .* without the chunk IEND"),
    "changed": ("plan.png", SOUND_PNG[:-40] + b"x" + SOUND_PNG[-39:], "wrong checksum of the chunk b'IDAT'"),
    "endless header": ("plan.pgm", b"P5 " + b"#" * 5_000_000, r"image: .*damaged.*header"),
    "many digits": ("plan.pgm", b"P2 2000 2000 255 " + b"1 " * 500, r"image: .*2000 x 2000 pixels, at most 1000000"),
    "dust on the floor": ("plan.png", encoded(noise(1900, 0.1)), r"image: \d+ pieces of wall, at most 5000; erase"),
    "no yaml": ("map.yaml", b"image: [", r"no yaml"),
    "yaml of another kind": ("map.yaml", b"- 1\n- 2\n", r"a mapping with image, resolution and origin .*list"),
    "yaml with a tag": ("map.yaml", sheet(mode="!!python/object/apply:os.getcwd []"), r"no yaml: .*tag"),
    "billion laughs": ("map.yaml", b"a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n", r"sheet\.image: Field required"),
    "yaml with a field twice": ("map.yaml", sheet() + b"resolution: 0.1\n", r"map\.yaml: resolution: given twice"),
    "yaml nested deep": ("map.yaml", b"a: " + b"[" * 9000, r"no yaml: maximum recursion depth"),
    "yaml too large": ("map.yaml", b"#" * 20_001, r"20001 bytes, at most 20000"),
    "resolution as text": ("map.yaml", sheet(resolution="'0.05'"), r"resolution: .*'0\.05'"),
    "resolution of many digits": ("map.yaml", sheet(resolution="0x" + "f" * 15_000), r"resolution: .*valid number"),
    "origin far away": ("map.yaml", sheet(origin="[0, 0, 1000]"), r"origin\.2: .*less than or equal to 6\.28.*1000"),
    "unknown mode": ("map.yaml", sheet(mode="colourful"), r"mode: .*'trinary', 'scale' or 'raw' .*'colourful'"),
    "thresholds crossed": ("map.yaml", sheet(free_thresh="0.7"), r"free_thresh: 0\.7 is not below occupied_thresh"),
    "path that leaves": ("map.yaml", sheet(image="../../etc/passwd"), r"image: '\.\./\.\./etc/passwd'"),
    "absolute path": ("map.yaml", sheet(image="/etc/hostname"), r"image: '/etc/hostname' leaves the folder"),
    "NUL in the path": ("map.yaml", sheet(image='"a\\0b"'), r"image: 'a.*b': no such file"),
    "all is unknown": ("map.yaml", sheet(free_thresh="0"), "no pixel is floor"),
    "DXF": ("a.dxf", b"0", "DXF.*HouseExpo"),
    "GeoJSON": ("a.json", b'{"type": "FeatureCollection", "features": []}', "GeoJSON.*HouseExpo"),
    "ProcTHOR": ("a.json", b'{"rooms": [], "walls": [], "objects": [], "doors": []}', "ProcTHOR.*HouseExpo"),
    "RMF": ("a.yaml", b"levels: {L1: {vertices: []}}", "RMF.*HouseExpo"),
    "TopoJSON": ("a.json", b'{"type": "Topology", "objects": {}}', OTHER_JSON),
}  # fmt: skip


def written(folder: Path, name: str) -> Path:
    """The file of a case, next to a valid map.pgm. Seen: half a picture was read as a plan, the rest being black."""
    plans.save(TWO_ROOMS, folder / "map.pgm")
    path = folder / BAD[name][0]
    path.write_bytes(BAD[name][1])
    return path


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_with_file_field_and_bound(name: str, tmp_path: Path) -> None:
    path = written(tmp_path, name)
    with pytest.raises(LayoutError, match=BAD[name][2]) as caught:
        load_plan(path, resolution_m=0.05)
    assert str(caught.value).startswith(f"{path}: ")
    assert len(str(caught.value)) < 600 + len(str(path))


NO_FILE = r"no such file|cannot be read|a folder|resolution_m"


def test_files_that_are_none(tmp_path: Path) -> None:
    (tmp_path / "folder.json").mkdir()
    for name in ("missing.json", "missing.png", "missing.yaml", "folder.json"):
        with pytest.raises(LayoutError, match=NO_FILE):
            load_plan(tmp_path / name, resolution_m=0.05)
    for name in ("x" * 5000, "nul\0byte"):  # which no file can have
        for ending in ("", ".png", ".yaml", ".json"):
            with pytest.raises(LayoutError, match=NO_FILE):
                load_plan(name + ending)
            with pytest.raises(LayoutError, match=NO_FILE):
                gym.make("mecp_env/FloorPlan-v0", plan=name + ending)


def test_a_link_does_not_lead_out_of_the_folder(tmp_path: Path) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    plans.save(plans.two_rooms_picture(), tmp_path / "map.pgm")
    (inside / "map.pgm").symlink_to(tmp_path / "map.pgm")
    (inside / "map.yaml").write_bytes(sheet())
    with pytest.raises(LayoutError, match="leaves the folder"):
        load_plan(inside / "map.yaml")


@pytest.mark.parametrize(
    ("file", "kind"), [("map.pgm", "houseexpo"), ("map.yaml", "image"), ("house.json", "layout"), ("map.pgm", "plan")]
)
def test_a_kind_that_the_file_is_not_is_refused(file: str, kind: Any, tmp_path: Path) -> None:
    plans.map_pair(tmp_path, plans.two_rooms_picture())
    (tmp_path / "house.json").write_bytes(house())
    with pytest.raises(LayoutError, match=f"kind: .*{kind}"):
        load_plan(tmp_path / file, kind=kind, resolution_m=0.05)


def test_labelled_images_that_are_none(tmp_path: Path) -> None:
    rng, touching, door = np.random.default_rng(1), plans.labelled_picture(), plans.labelled_picture()
    touching[40:50, 92:94] = (200, 30, 30)
    door[5:9, 30:40] = 255
    cases = {
        "two rooms touch at column": touching,
        "joins 0 rooms": door,
        "more than 2000 colours": rng.integers(0, 255, (200, 200, 3), dtype=np.uint8),
        "colours overlap": rng.integers(0, 9, (1900, 1900, 1), dtype=np.uint8) * np.array([20, 3, 9], dtype=np.uint8),
    }
    begun = time.thread_time()
    for message, picture in cases.items():
        with pytest.raises(LayoutError, match=message):
            load_plan(plans.save(picture, tmp_path / "plan.png"), kind="labelled", resolution_m=0.05)
    assert time.thread_time() - begun < 3.0 * SECONDS


@pytest.mark.slow
@needs_linux
def test_bad_files_cost_little_time_and_less_than_200_megabytes(tmp_path: Path) -> None:
    """So do bars of 4096 x 4096 pixels in a palette of which one colour is clear. Seen: decoded, 256 MB."""
    bars, files = tmp_path / "bars.png", []
    image = Image.fromarray(np.tile(np.arange(4096) // 64 % 3, (4096, 1)).astype(np.uint8))
    image.putpalette([0, 0, 0, 255, 255, 255, 90, 90, 90])
    image.save(bars, transparency=2)
    for name in BAD:
        (tmp_path / name).mkdir()
        files.append(written(tmp_path / name, name))
    sound = str(plans.map_pair(tmp_path, TWO_ROOMS))  # is read first, with all that readers import
    read = "from mecp_env.floorplans import load_plan; read = lambda path: load_plan(path, resolution_m=0.05)"
    rows = costs(f"{read}; read({sound!r})", [bars, *files])
    assert ["LayoutError" in row.said for row in rows] == [False] + [True] * len(files)
    assert not [row for row in rows if row.seconds >= SECONDS or row.growth_mb >= MEGABYTES]


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), walls=st.integers(0, 25), turn=st.sampled_from([0, 0, 17, 45]))
def test_any_drawing_becomes_a_sound_layout_or_is_refused(
    seed: int, walls: int, turn: int, tmp_path_factory: Any
) -> None:
    """`load_plan` checks what it makes; a floor that is wide enough is never refused."""
    rng = np.random.default_rng(seed)
    picture = np.full((160, 160), 255, dtype=np.uint8)
    for x, y, width, height in rng.integers(0, 160, (walls, 4)).tolist():
        picture[y : y + (3 if width > height else height), x : x + (width if width > height else 3)] = 0
    picture[60:100, 60:100] = 255
    turned = np.asarray(Image.fromarray(picture).rotate(turn))
    path = plans.save(turned, tmp_path_factory.mktemp("drawn") / "plan.png")
    assert load_plan(path, resolution_m=0.05, free_above=100).rooms
