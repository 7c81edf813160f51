"""Files of at most 5 MB that would take the most memory, by the kind of file, and a process that reads them."""

from __future__ import annotations

import base64
import gzip
import io
import json
import random
import zipfile
from collections.abc import Iterator

import numpy as np
from PIL import Image

SIZE = 5_000_000
WALLS = ('{"walls":LIST}', '{"walls":[{"points":LIST}]}')
ITEMS = {  # JSON values of the least text for the most memory
    "numbers": "999,",
    "floats": "1e9,",
    "wide texts": '"\U0001f600",',
    "lists": "[0],",
    "objects": '{"a":0},',
}
PLAN = "from mecp_env.floorplans import load_plan; read = lambda path: load_plan(path, resolution_m=0.05)"
LOG = "from mecp_env.logs import read_log as read"
READERS = {  # kind -> name of the file, and what reads it
    "page": ("a.html", "from mecp_env.render.replay_page import read_page as read"),
    "map": ("a.zip", "from mecp_env.slam import SlamPipeline; read = SlamPipeline.from_map"),
    "log": ("a.log", LOG),
    "packed_log": ("a.log.gz", LOG),
    "archive": ("a.npz", LOG),
    "table": ("a.csv", LOG),
    "dat": ("a.dat", LOG),
    "picture": ("a.png", PLAN),
    "tiff": ("a.tiff", PLAN),
    "layout": ("a.json", "from mecp_env.world.layout import load_layout as read"),
    "plan": ("a.json", "from mecp_env.floorplans import load_plan as read"),
    "submission": ("a.json", "from mecp_env.policies.suites import read_submission as read"),
    "run": ("config.json", "from mecp_env.cli.demo import recipe_of; read = lambda path: recipe_of(path.parent)"),
}


def items(kind: str, size: int) -> str:
    """A list of equal values in so many bytes."""
    item = ITEMS[kind]
    return f"[{item * (size // len(item.encode()))}0]"


def noise(size: int) -> bytes:
    """What cannot be packed, so that limits that grow with the file are large."""
    return base64.b64encode(random.Random(0).randbytes(3 * size // 4))


def pages() -> Iterator[tuple[str, bytes]]:
    """Replay pages, which hold a packed JSON text."""
    texts = {f"{kind} {size}": items(kind, size * 10**6) for kind in ITEMS for size in (18, 6)}
    texts["spaces"] = " " * 200_000_000
    texts["wide text"] = '"\\ud83d\\ude00' + "a" * 30_000_000 + '"'
    for name, text in texts.items():
        run = b'{"title":"' + noise(3_550_000) + b'","frames":' + text.encode() + b"}"
        packed = base64.b64encode(gzip.compress(run, 9))
        yield name, b'<script id="run" type="text/plain" data-version="1">' + packed + b"</script>"


def maps() -> Iterator[tuple[str, bytes]]:
    """Maps: a zip of a JSON text and of arrays."""
    from mecp_env.slam.map_file import FILE

    structures = {f"{kind} {size}": f'{{"@list": {items(kind, size)}}}' for kind in ITEMS for size in (10**6, 10**7)}
    structures["arrays"] = '{"@array": [{"@bytes": ["|u1", [42000000], 0]}, true]}'
    for name, structure in structures.items():
        file = io.BytesIO()
        head = json.dumps(FILE._asdict())[:-1]
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
            archive.writestr("state.json", f'{head}, "state": {structure}}}')
            archive.writestr("arrays.bin", bytes(38_000_000 * (name == "arrays")) + noise(4_900_000))
        yield name, file.getvalue()


def documents(most: int, *fields: str) -> Iterator[tuple[str, bytes]]:
    """JSON as it is: lists, alone and in fields of what is read."""
    for kind in ITEMS:
        for field in ("LIST", *fields):
            yield f"{kind} {field}", field.replace("LIST", items(kind, most - 100)).encode()
    yield "keys", ("{" + ",".join(f'"{k}":0' for k in range(most // 12)) + "}").encode()


def submissions() -> Iterator[tuple[str, bytes]]:
    """Results of a suite: of any content, and of values that are all wrong behind a right checksum."""
    from mecp_env.policies.suites import FORMAT, SUITES, VERSION, checksum_of

    yield from documents(SIZE, '{"results":LIST}')
    name, suite = next(iter(SUITES.items()))
    head = {"format": FORMAT, "version": VERSION, "suite": name, "hash": suite.frozen}
    row = {"task": "x", "policy": "y", "estimator": "slam", "figures": {}, "episodes": []}
    many = {str(k): "x" for k in range(SIZE // 20)}
    for what, results in {
        "results": [0] * (SIZE // 3 - 200),
        "figures": [row | {"figures": many}],
        "episodes": [row | {"episodes": [0] * (SIZE // 3 - 200)}],
        "an episode": [row | {"episodes": [many]}],
    }.items():
        content = head | {"results": results}
        yield what, json.dumps(content | {"checksum": checksum_of(content)}, separators=(",", ":")).encode()


LINES = {
    "odometry": b"ODOM 1 1 1 0 0 0 1 h 1\n",
    "short scans": b"FLASER 2 1 1 0 0 0 0 0 0\n",
    "others": b"a\n",
    "long scans": b"FLASER 20000 " + b"1 " * 20000 + b"0 0 0 0 0 0 1 h 1\n",
}


def tables(kind: str) -> Iterator[tuple[str, bytes]]:
    """Logs as text."""
    if kind == "log":
        yield from ((name, line * (SIZE // len(line))) for name, line in LINES.items())
        yield "words", b"FLASER 999 " + b"1 " * (SIZE // 2 - 10)
    elif kind == "packed_log":
        yield from ((name, gzip.compress(line * (90_000_000 // len(line)), 9)) for name, line in LINES.items())
    elif kind == "table":
        yield "narrow", b"t,x,y,heading,10,20,30,40,50,60,70,80\n" + b"1,1,1,1,1,1,1,1,1,1,1,1\n" * (SIZE // 24 - 9)
        yield "two readings", b"t,1,2\n" + b",,\n" * (SIZE // 3 - 9)
        yield "beams", b"t,angle,range\n" + b"1,1,1\n" * (SIZE // 6 - 9)
        yield "wide", b"t," + b",".join(b"%d" % k for k in range(20_000)) + (b"\n" + b"," * 20_000) * 240
        yield "names", "\U0001f600,".encode() * (SIZE // 5)
    else:
        yield "words", b"1 " * (SIZE // 2)
        yield "narrow", (b"1 " * 34 + b"\n") * (SIZE // 69)


def archives() -> Iterator[tuple[str, bytes]]:
    """Logs as arrays."""
    for kind in ("<f8", "|u1", "<U1"):
        for rows, beams in ((400, 20_000), (4_000_000, 2), (200, 20_000)):
            file = io.BytesIO()
            times = np.sort(np.arange(rows) % 1000)  # millions of different ones could not be packed
            arrays = {"t": times, "ranges": np.zeros((rows, beams), kind), "angles": np.arange(beams)}
            np.savez_compressed(file, **arrays, odo=np.zeros((rows, 3), "|u1"))
            yield f"{kind} {rows}", file.getvalue()


def pictures(kind: str) -> Iterator[tuple[str, bytes]]:
    """Plans as pictures of as many pixels as are read, with little in them or much."""
    side = np.arange(4096)
    rooms = np.where((side[:, None] % 400 < 2) | (side % 400 < 2), 0, 255).astype(np.uint8)
    comb = np.where((np.arange(1900) % 4 < 1) & (np.arange(1900)[:, None] > 3), 0, 255).astype(np.uint8)
    for mode in ("L", "P", "RGB", "RGBA", "LA"):
        yield f"rooms {mode}", encoded(Image.fromarray(rooms).convert(mode), kind)
    yield "comb", encoded(Image.fromarray(comb).convert("1"), kind)
    specks = np.where(np.random.default_rng(0).random((2000, 2000)) < 0.5, 0, 255).astype(np.uint8)
    yield "noise", encoded(Image.fromarray(specks).convert("1"), kind)


def encoded(image: Image.Image, kind: str) -> bytes:
    """A PNG or TIFF file of a picture."""
    file = io.BytesIO()
    image.save(file, "PNG") if kind == "picture" else image.save(file, "TIFF", compression="tiff_adobe_deflate")
    return file.getvalue()


def bombs(kind: str) -> Iterator[tuple[str, bytes]]:
    """The files of a kind, of at most `SIZE` bytes."""
    made = {
        "page": pages,
        "map": maps,
        "archive": archives,
        **dict.fromkeys(("picture", "tiff"), lambda: pictures(kind)),
        **dict.fromkeys(("layout", "plan"), lambda: documents(2_000_000, *WALLS)),
        "submission": submissions,
        "run": lambda: documents(SIZE, '{"config":LIST}'),
    }
    for name, data in made.get(kind, lambda: tables(kind))():
        if len(data) <= SIZE:
            yield name, data


MEASURE = """
import os, sys, time, warnings
from pathlib import Path
warnings.simplefilter("ignore")
READ
for path in map(Path, sys.argv[1:]):
    if child := os.fork():  # what a file left behind is not counted for the next one
        assert os.waitpid(child, 0)[1] == 0
        continue
    Path("/proc/self/clear_refs").write_text("5")  # forget the peak
    start = time.process_time()
    try:
        said = type(read(path)).__name__
    except ValueError as error:
        said = "/".join(kind.__name__ for kind in type(error).__mro__)
    peak = int(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0]) / 1024
    print(path.parent.name, round(peak), round(time.process_time() - start, 1), said, sep=";", flush=True)
    os._exit(0)
"""
