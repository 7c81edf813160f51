"""Untrusted layout files: any content is read or refused by one clear LayoutError, within the limits."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mecp_env.core.errors import LayoutError
from mecp_env.world.layout import load_layout, shipped_layouts
from tests.floorplans.untrusted import MEGABYTES, SECONDS, costs, layout
from tests.world.hard_layouts import as_file, hard
from tests.world.test_layout import BAD_DOCUMENTS, BAD_FILES, DOCUMENTS

LETTERS = 800


def files(folder: Path) -> list[Path]:
    """Every layout that is hard or wrong, as a file."""
    contents = {name: as_file(name) for name in hard()} | {name: data for name, (data, _) in BAD_FILES.items()}
    for name, (spoil, _) in BAD_DOCUMENTS.items():
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
        ("pillars beyond number", r"320014 faces, at most 20000"),
        ("a comb", r"walls: faces: too many within 0\.44 m of each other, at most 100000 pairs"),
        ("rooms around a point", r"rooms: too many within 0 m of each other, at most 10000 pairs"),
        ("rooms beyond number", r"layout\.rooms: .*at most 1000"),
        ("too many corners of rooms", r"30010 faces, at most 20000"),
        ("starts beyond number", r"layout\.starts: .*at most 1000"),
        ("doors beyond number", r"layout\.doors: .*at most 2000"),
        ("nothing but wrong walls", r"walls\.1\.points: Field required"),
        ("names of unknown rooms", r"doors\.0\.rooms\.0: no room is called 'hal'; did you mean 'hall'\?"),
        ("a name of a megabyte", r"rooms\.0\.name: .*at most 80 characters"),
    ],
)
def test_what_is_beyond_the_limits_is_refused_with_the_bound(name: str, said: str) -> None:
    with pytest.raises(LayoutError, match=said) as caught:
        load_layout(hard()[name])
    assert len(str(caught.value)) < 600


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"walls.1.points.0.0": float("nan")}, r"^layout\.walls\.1\.points\.0\.0: [\w ]+finite number \(given: nan\)$"),
        ({"walls.1.thicknes_m": 0.1}, r"^layout\.walls\.1\.thicknes_m: no such field; did you mean 'thickness_m'\?"),
        ({"strats": []}, r"^layout\.strats: no such field; did you mean 'starts'\? \(given: \[\]\)$"),
        ({"doors.0.opening": "cutt"}, r"^layout\.doors\.0\.opening: .*did you mean 'cut'\? \(given: 'cutt'\)$"),
        ({"doors.0.rooms.0": "wets"}, r"^doors\.0\.rooms\.0: no room is called 'wets'; did you mean 'west'\?$"),
    ],
)  # fmt: skip
def test_one_thing_wrong_is_one_message_with_a_guess(change: dict[str, object], said: str) -> None:
    document = json.loads(json.dumps(DOCUMENTS["two_rooms"]))
    for path, value in change.items():
        *parents, last = [int(key) if key.isdigit() else key for key in path.split(".")]
        place = document
        for key in parents:
            place = place[key]
        place[last] = value
    with pytest.raises(LayoutError, match=said):
        load_layout(document)


def test_an_obstacle_of_a_kind_that_is_none_gets_a_guess() -> None:
    document = DOCUMENTS["two_rooms"] | {"obstacles": [{"kind": "boxx", "centre": [1, 1], "size": [1, 1]}]}
    with pytest.raises(LayoutError, match=r"obstacles\.0: .*'box', 'polygon', 'round'; did you mean 'box'\?"):
        load_layout(document)


def test_a_number_of_any_length_is_refused_and_not_printed() -> None:
    document = json.loads(json.dumps(DOCUMENTS["two_rooms"]))
    document["doors"][0]["width_m"] = 10**5000
    with pytest.raises(LayoutError, match=r"doors\.0\.width_m"):
        load_layout(document)


@pytest.mark.parametrize(("given", "meant"), [("papre", "paper"), ("two_room", "two_rooms"), ("Office", "office")])
def test_a_name_that_is_none_gets_a_guess(given: str, meant: str) -> None:
    with pytest.raises(LayoutError, match=f"did you mean '{meant}'"):
        load_layout(given)
    assert meant in shipped_layouts()
