"""Untrusted layout files: any content is read or refused by one clear LayoutError, within the limits."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mecp_env.core.errors import LayoutError
from mecp_env.world.layout import load_layout
from tests.floorplans.untrusted import MEGABYTES, SECONDS, costs, layout
from tests.world.hard_layouts import as_file, hard
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
