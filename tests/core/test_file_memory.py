"""A file of at most 5 MB that a user received takes at most 300 MB, the whole process, and ends soon."""

from __future__ import annotations

import base64
import gzip
import io
import json
import random
import tracemalloc
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mecp_env.core import files
from tests.processes import costs, needs_linux

MOST_MB, MOST_S = 300, 20.0  # of processor time
SIZE = 5_000_000
ITEMS = {"numbers": "999,", "wide texts": '"\U0001f600",', "lists": "[0],", "objects": '{"a":0},'}  # of a long list
LINES = b"ODOM 1 1 1 0 0 0 1 h 1\n", b"FLASER 2 1 1 0 0 0 0 0 0\n", b"FLASER 9 " + b"1 " * 20_000 + b"0 h 1\n", b"a\n"
LOG = "from mecp_env.logs import read_log as read"
READERS = {  # kind -> name of the file, and what reads it
    "page": ("a.html", "from mecp_env.render.replay_page import read_page as read"),
    "map": ("a.zip", "from mecp_env.slam import SlamPipeline; read = SlamPipeline.from_map"),
    "log": ("a.log", LOG),
    "packed": ("a.log.gz", LOG),
    "archive": ("a.npz", LOG),
    "table": ("a.csv", LOG),
    "picture": ("a.png", "from mecp_env.floorplans import load_plan; read = lambda p: load_plan(p, resolution_m=0.05)"),
    "layout": ("a.json", "from mecp_env.world.layout import load_layout as read"),
    "plan": ("a.json", "from mecp_env.floorplans import load_plan as read"),
    "submission": ("a.json", "from mecp_env.policies.suites import read_submission as read"),
    "run": ("config.json", "from mecp_env.cli.demo import recipe_of; read = lambda path: recipe_of(path.parent)"),
}
FIELDS = {"layout": '{"walls":LIST}', "plan": '{"walls":[{"points":LIST}]}'}
FIELDS |= {"submission": '{"results":LIST}', "run": '{"config":LIST}'}


def items(kind: str, size: int) -> str:
    """A list of equal values in so many bytes."""
    item = ITEMS[kind]
    return f"[{item * (size // len(item.encode()))}0]"


def noise(size: int) -> bytes:
    """What cannot be packed, so that limits that grow with the file are large."""
    return base64.b64encode(random.Random(0).randbytes(3 * size // 4))


def page(text: str) -> bytes:
    """A replay page, which holds a packed JSON text."""
    run = b'{"title":"' + noise(3_550_000) + b'","frames":' + text.encode() + b"}"
    packed = base64.b64encode(gzip.compress(run, 9))
    return b'<script id="run" type="text/plain" data-version="1">' + packed + b"</script>"


def saved_map(text: str) -> bytes:
    """A map: a zip of a JSON text and of arrays."""
    from mecp_env.slam.map_file import FILE

    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        archive.writestr("state.json", f'{json.dumps(FILE._asdict())[:-1]}, "state": {{"@list": {text}}}}}')
        archive.writestr("arrays.bin", noise(4_900_000))
    return file.getvalue()


def archive(rows: int, beams: int) -> bytes:
    """A log as arrays."""
    file, times = io.BytesIO(), np.sort(np.arange(rows) % 1000)
    arrays = {"t": times, "ranges": np.zeros((rows, beams)), "angles": np.arange(beams)}
    np.savez_compressed(file, **arrays, odo=np.zeros((rows, 3), "|u1"))
    return file.getvalue()


def picture(mode: str) -> bytes:
    """A plan of as many pixels as are read: rooms, or specks."""
    file, side = io.BytesIO(), np.arange(4096)
    rooms = (side[:, None] % 400 < 2) | (side % 400 < 2)
    drawn = rooms if mode != "1" else np.random.default_rng(0).random((2000, 2000)) < 0.5
    Image.fromarray(np.where(drawn, 0, 255).astype(np.uint8)).convert(mode).save(file, "PNG")
    return file.getvalue()


def bombs(kind: str) -> Iterator[bytes]:
    """Files of a kind that would take the most memory."""
    if kind in FIELDS:
        most = 2_000_000 if kind in ("layout", "plan") else SIZE
        yield from (FIELDS[kind].replace("LIST", items(name, most - 100)).encode() for name in ITEMS)
    elif kind in ("page", "map"):
        yield from ((page if kind == "page" else saved_map)(items(name, 10**7)) for name in ITEMS)
    elif kind == "log":
        yield from (line * (SIZE // len(line)) for line in LINES)
    elif kind == "packed":
        yield from (gzip.compress(line * (90_000_000 // len(line)), 9) for line in LINES)
    elif kind == "table":
        yield b"t,1,2\n" + b",,\n" * (SIZE // 3 - 9)
        yield b"t," + b",".join(b"%d" % k for k in range(20_000)) + (b"\n" + b"," * 20_000) * 240
    elif kind == "archive":
        yield from (archive(*shape) for shape in ((400, 20_000), (4_000_000, 2)))
    else:
        yield from (picture(mode) for mode in ("P", "RGBA", "1"))


@needs_linux
@pytest.mark.slow
@pytest.mark.parametrize("read", dict.fromkeys(read for _, read in READERS.values()), ids=lambda read: read.split()[1])
def test_no_small_file_takes_much_memory(read: str, tmp_path: Path) -> None:
    paths = []
    for kind, (name, reads) in READERS.items():
        for number, data in enumerate(bombs(kind) if reads == read else ()):
            assert len(data) <= SIZE
            paths.append(tmp_path / f"{kind} {number}" / name)
            paths[-1].parent.mkdir()
            paths[-1].write_bytes(data)
    rows = costs(read, paths)
    assert len(rows) == len(paths) >= 2
    assert not [row for row in rows if row.peak_mb > MOST_MB or row.seconds > MOST_S]
    assert all("Error" not in row.said or "MecpError" in row.said for row in rows)


@pytest.mark.parametrize("kind", ITEMS)
def test_the_memory_of_values_is_not_underestimated(kind: str) -> None:
    """Python's own allocator says what the values take."""
    text = items(kind, 400_000)
    tracemalloc.start()
    json.loads(text)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < files.memory_of(text.encode()) < 4 * peak


def test_values_that_take_too_much_are_refused_before_they_are_made(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("[" + "[]," * 2_000_000 + "0]")
    with pytest.raises(ValueError, match="too much for its size"):
        files.read_json(tmp_path / "a.json", 10**7)
    with pytest.raises(ValueError, match="at most 10"):
        files.read_json(tmp_path / "a.json", 10)
