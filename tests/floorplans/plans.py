"""Plans drawn by hand for the tests of importers and exporters, and where the real ones lie."""

import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

RESOLUTION_M = 0.05
SECONDS, MEGABYTES = 6.0, 200  # at most for a file, as docs/plans.md promises, with twice the time for a busy machine
Picture = NDArray[np.uint8]

_FOLDERS = (parent / "shared/data/plans" for parent in Path(__file__).resolve().parents)
REAL = next((folder for folder in _FOLDERS if folder.is_dir()), None)


def needs_real(test: Callable[..., None]) -> Callable[..., None]:
    """A test of real plans, some of whose places cannot be reached, of which warnings tell."""
    lenient = pytest.mark.filterwarnings("ignore::mecp_env.core.errors.PlanWarning")(test)
    return pytest.mark.skipif(REAL is None, reason="shared/data/plans is not beside the repository")(lenient)


def real(name: str) -> Path:
    assert REAL is not None
    return REAL / name


def two_rooms_picture() -> Picture:
    """Two rooms of 4 x 5 m, walls of 0.1 m, a door of 0.9 m; 10 pixels of unknown around."""
    picture = np.full((124, 186), 205, dtype=np.uint8)
    picture[10:114, 10:176] = 0
    picture[12:112, 12:92] = 254
    picture[12:112, 94:174] = 254
    picture[62:80, 92:94] = 254
    return picture


DOOR_M = ((12 + 80 + 1) * RESOLUTION_M, (124 - 71) * RESOLUTION_M)  # centre of its door


def corridor_picture() -> Picture:
    """A corridor 1.6 m wide round a corner, three rooms beside it and an alcove; a free pillar in the corridor."""
    picture = np.zeros((240, 240), dtype=np.uint8)
    picture[100:132, 10:200] = 255
    picture[132:220, 168:200] = 255
    for left in (10, 72, 134):
        picture[20:97, left : left + 59] = 255
        picture[97:100, left + 20 : left + 38] = 255
    picture[132:140, 20:60] = 255  # an alcove, as wide as it is open
    picture[113:119, 100:106] = 0
    return picture


def office_picture() -> Picture:
    """Four rooms behind a double wall with a hollow, a corridor with a door frame, and three rooms below it.

    The doors of the upper rooms lead through both faces of the double wall; between two of them is 1.5 m of it. Below,
    a partition ends 0.9 m before the wall of the corridor, and the door of the last room is 0.4 m wide.
    """
    picture = np.zeros((240, 400), dtype=np.uint8)
    for left, right in ((10, 100), (103, 190), (193, 280), (283, 390)):
        picture[10:100, left:right] = 255
    picture[103:109, 10:390] = 255  # the hollow
    for left in (40, 110, 157, 220, 330):
        picture[100:112, left : left + 17] = 255
    picture[112:144, 10:390] = 255  # the corridor
    picture[112:114, 200:202] = picture[142:144, 200:202] = 0  # a frame
    for left, right in ((10, 120), (123, 280), (283, 390)):
        picture[147:230, left:right] = 255
    picture[147:165, 120:123] = 255  # beside the end of the partition
    picture[144:147, 50:68] = 255
    picture[144:147, 330:338] = 255
    return picture


def save(picture: Picture, path: Path) -> Path:
    Image.fromarray(picture).save(path)
    return path


def map_pair(folder: Path, picture: Picture, **fields: Any) -> Path:
    """A map_server pair; the path of the yaml file. A field of None is left out."""
    save(picture, folder / "map.pgm")
    given = {"image": "map.pgm", "resolution": RESOLUTION_M, "origin": [0.0, 0.0, 0.0], "negate": 0}
    given |= {"occupied_thresh": 0.65, "free_thresh": 0.196} | fields
    path = folder / "map.yaml"
    path.write_text("".join(f"{key}: {json.dumps(value)}\n" for key, value in given.items() if value is not None))
    return path


def stairs(a: tuple[float, float], b: tuple[float, float]) -> list[tuple[float, float]]:
    """From `a` to `b` in steps of 1 cm along x and y."""
    count = round(max(abs(b[0] - a[0]), abs(b[1] - a[1])) * 100)
    line = np.round(np.linspace(a, b, count + 1), 2)
    corners = [q for p, r in pairwise(line) for q in (tuple(p), (r[0], p[1]))]
    kept = [p for i, p in enumerate([*corners, tuple(line[-1])]) if i == 0 or p != corners[i - 1]]
    return [(float(x), float(y)) for x, y in kept]


def house() -> dict[str, Any]:
    """A home of three rooms as HouseExpo writes it: one polygon, fingers of 0.12 m, one wall slanted in stairs."""
    verts = [
        (0.1, 0.1), (0.1, 3.0), (1.99, 3.0), (2.0, 3.01), (2.0, 3.11), (1.99, 3.12), (0.1, 3.12), (0.1, 6.0),
        (2.94, 6.0), *stairs((2.94, 6.0), (3.94, 4.6)), (3.94, 4.4), (4.06, 4.4), *stairs((4.06, 4.6), (3.06, 6.0)),
        (8.0, 6.0), (8.0, 0.1), (4.06, 0.1), (4.06, 3.5), (3.94, 3.5), (3.94, 3.12), (2.91, 3.12), (2.9, 3.11),
        (2.9, 3.01), (2.91, 3.0), (3.94, 3.0), (3.94, 0.1),
    ]  # fmt: skip
    boxes = {"Bed_Room": [[-0.2, 0.0, 4.1, 3.2]], "Kitchen": [[0.0, 2.7, 4.4, 6.3]], "Hall": [[3.7, -0.1, 8.3, 6.1]]}
    return {"verts": [list(p) for p in verts], "id": "by hand", "room_category": boxes, "room_num": 3}


def labelled_picture() -> Picture:
    """The two rooms in colours, their door a white line; a third room with an opening of 3 m to the second."""
    picture = np.zeros((124, 260, 3), dtype=np.uint8)
    picture[12:112, 12:92] = (200, 30, 30)
    picture[12:112, 94:174] = (30, 200, 30)
    picture[62:80, 92:94] = (255, 255, 255)
    picture[20:104, 176:250] = (30, 30, 200)
    picture[32:92, 174:176] = (255, 255, 255)
    return picture
