"""Untrusted layout files: any content is read or refused by one clear LayoutError, within the limits."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mecp_env.core.errors import LayoutError
from mecp_env.world.layout import load_layout
from tests.floorplans.untrusted import MEGABYTES, SECONDS, costs, layout
from tests.world.test_layout import BAD_DOCUMENTS, BAD_FILES, DOCUMENTS

LETTERS = 800


def files(folder: Path) -> list[Path]:
    """Every layout that is hard or wrong, as a file."""
    contents = {name: as_file(name) for name in hard()} | {name: data for name, (data, _) in BAD_FILES.items()}
    for name in BAD_DOCUMENTS.keys() - {"any length"}:
        spoil, _ = BAD_DOCUMENTS[name]
        document = json.loads(json.dumps(DOCUMENTS["two_rooms"]))
        spoil(document)
        contents[f"document {name}"] = json.dumps(document).encode()
    paths = [folder / f"{name.replace('/', ' ')}.json" for name in contents]
    for path, data in zip(paths, contents.values(), strict=True):
        path.write_bytes(data)
    return paths


@pytest.mark.slow
def test_layouts_cost_less_than_two_seconds_and_200_megabytes(tmp_path: Path) -> None:
    """Valid files too: no file can make a reader wait."""
    rows = costs(layout, "paper", files(tmp_path))
    for column, most in enumerate((SECONDS, MEGABYTES, LETTERS)):
        assert max((row[column], row[-1]) for row in rows) < (most, "")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("9,000 scattered walls", r"36014 faces, at most 20000 \(two for each point of a wall"),
        ("woven walls", r"walls: too many within 0 m of each other, at most 10000 pairs"),
        ("a comb", r"walls: faces: too many within 0\.44 m of each other, at most 100000 pairs"),
        ("rooms beyond number", r"layout\.rooms: .*at most 1000"),
        ("doors beyond number", r"layout\.doors: .*at most 2000"),
        ("names of unknown rooms", r"doors\.0\.rooms\.0: no room is called 'hal'; did you mean 'hall'\?"),
        ("a name of a megabyte", r"rooms\.0\.name: .*at most 80 characters"),
    ],
)
def test_what_is_beyond_the_limits_is_refused_with_the_bound(name: str, said: str) -> None:
    with pytest.raises(LayoutError, match=said) as caught:
        load_layout(hard()[name])
    assert len(str(caught.value)) < 600


Document = dict[str, Any]
HALL = [[-200.0, -200.0], [200.0, -200.0], [200.0, 200.0], [-200.0, 200.0]]


def hall(**fields: Any) -> Document:
    """One room of 400 x 400 m, with some fields replaced."""
    around = {"points": [*HALL, HALL[0]]}
    given = {"walls": [], "rooms": [{"name": "hall", "polygon": HALL}], "starts": [{"point": [0.0, 0.0]}]} | fields
    return {"name": "hall", **given, "walls": [around, *given["walls"]]}


def scattered(count: int, length: float = 1.0) -> list[Document]:
    """So many straight walls anywhere, none at the start."""
    rng = np.random.default_rng(0)
    places, angles = rng.uniform(-190.0, 190.0, (3 * count, 2)), rng.uniform(0.0, 6.3, 3 * count)
    far = np.hypot(*places.T) > length + 1.0
    ends = places + length * np.column_stack([np.cos(angles), np.sin(angles)])
    return [{"points": pair} for pair in np.stack([places, ends], axis=1)[far][:count].round(2).tolist()]


def lattice(count: int, step: float) -> list[tuple[float, float]]:
    """Places in rows, none within 3 m of the start."""
    side = int(np.ceil(np.sqrt(count))) + 4
    places = [((i - side / 2) * step, (j - side / 2) * step) for i in range(side) for j in range(side)]
    return [place for place in places if np.hypot(*place) > 3.0][:count]


def weave(count: int) -> list[Document]:
    """So many walls along x and as many along y: every one crosses every other one."""
    at = np.linspace(-190.0, 190.0, count).round(3).tolist()
    return [{"points": p} for c in at for p in ([[-199.0, c], [199.0, c]], [[c, -199.0], [c, 199.0]])]


def comb(teeth: int) -> list[list[float]]:
    """A ring with so many teeth, four points each."""
    points = [[-150.0, 10.0]]
    for x in np.linspace(-150.0, 150.0, teeth).tolist():
        points += [[x, 10.0], [x, 180.0], [x + 0.01, 180.0], [x + 0.01, 10.0]]
    return [*points[1:], [151.0, 10.0], [151.0, 5.0], [-151.0, 5.0], [-151.0, 10.0]]


def gaps(count: int) -> list[Document]:
    """Doors between hall and hall amid the floor."""
    gap = {"width_m": 1.0, "rooms": ["hall", "hall"], "direction_deg": 0.0, "opening": "gap", "depth_m": 0.1}
    return [gap | {"centre": [x, y]} for x, y in lattice(count, 4.0)]


@cache
def hard() -> dict[str, Document]:
    """All of them, by name."""
    return {
        "9,000 scattered walls": hall(walls=scattered(9000)),
        "as many scattered walls as there may be": hall(walls=scattered(4995)),
        "woven walls": hall(walls=weave(140)),
        "boxes in rows": hall(obstacles=[{"kind": "box", "size": [0.3, 0.3], "centre": c} for c in lattice(4990, 2.0)]),
        "a comb": hall(solids=[{"outer": comb(4900)}]),
        "rooms beyond number": hall(rooms=[{"name": f"r{i}", "polygon": HALL} for i in range(1001)]),
        "starts among walls": hall(walls=scattered(4900), starts=[{"point": [0.0005 * i, 0.0]} for i in range(1000)]),
        "gaps amid the floor": hall(doors=gaps(2000)),
        "doors beyond number": hall(doors=gaps(2001)),
        "nothing but wrong points": hall(walls=[{"points": [[0]] * 900}] * 300),
        "names of unknown rooms": hall(doors=[gap | {"rooms": ["hal", "hall"]} for gap in gaps(2000)]),
        "a name of a megabyte": hall(rooms=[{"name": "x" * 900_000, "polygon": HALL}]),
    }  # fmt: skip


def as_file(name: str) -> bytes:
    """The JSON of a layout, as small as can be."""
    return json.dumps(hard()[name], separators=(",", ":")).encode()
