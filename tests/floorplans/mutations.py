"""Mutated real files: byte by byte, and by the structure of their format."""

import copy
import json
import struct
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from mecp_env.world.layout import LIBRARY
from tests.floorplans import plans

Random = np.random.Generator
BYTES = (b"-", b"0", b"9" * 8, b"e9", b"[", b"}", b'"', b",", b"nan", b"\0", b"\xff", b"&a ", b"!!x ", b"\n", b": ")
VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 1, 1e-9, 1e9, -1e300, 10**400, float("nan"), float("inf"), "", "x", "\ud800", "x" * 500,
    [], {}, [[]], [0, 0], [1, 2, 3], {"a": 1}, [[0, 0]] * 50, [None] * 9, "box", "gap", "west",
)  # fmt: skip
YAML_VALUES = (
    "", "~", "-1", "0", "1e99", ".nan", ".inf", "[]", "{}", "[1]", "[1, 2, 3, 4]", "true", "'0.05'", "../x", "*a",
    "&a 1", "!!python/object:os.system x", "!x y", "[[[[[1]]]]]", "0x" + "f" * 400, "|\n  x", "map.pgm", ".",
    "/etc/hostname", "\t",
)  # fmt: skip
SIZES = (0, 1, 2, 7, 255, 256, 4096, 4097, 65_535, 100_000, 2**31 - 1, 2**31, 2**32 - 1)


def made(folder: Path) -> dict[str, list[Path]]:
    """Files of each kind: the included layouts, and others made here."""
    house = folder / "house.json"
    house.write_text(json.dumps(plans.house()))
    return {
        "layout": sorted(LIBRARY.glob("*.json")),
        "house": [house],
        "sheet": [plans.map_pair(folder, plans.two_rooms_picture())],
        "pgm": [folder / "map.pgm"],
        "png": [plans.save(plans.corridor_picture(), folder / "plan.png")],
        "labelled": [plans.save(plans.labelled_picture(), folder / "rooms.png")],
    }


def spoilt_bytes(data: bytes, rng: Random) -> bytes:
    """`data` with one to four places overwritten, cut, doubled or exchanged."""
    for _ in range(int(rng.integers(1, 5))):
        at = int(rng.integers(0, len(data) + 1))
        piece = rng.bytes(int(rng.integers(0, 5))) if rng.random() < 0.5 else BYTES[int(rng.integers(len(BYTES)))]
        cut = int(rng.choice([0, 0, 1, 2, 20, 2000]))
        piece = data[at : at + cut] * 2 if rng.random() < 0.1 else piece
        data = data[:at] + piece + data[at + cut :]
    return data[: int(rng.integers(len(data) + 1))] if rng.random() < 0.1 else data


def spoilt_json(data: bytes, rng: Random) -> bytes:
    """A JSON text with one to three values replaced, removed, doubled, moved or renamed."""
    document = json.loads(data)
    for _ in range(int(rng.integers(1, 4))):
        if document:
            _spoil_at(document, rng)
    text = json.dumps(document)
    return text.replace('"name"', '"nam"', 1).encode() if rng.random() < 0.05 else text.encode()


def _spoil_at(place: Any, rng: Random) -> None:
    """Spoil something at a random depth of a list or dict, in place."""
    keys = list(place) if isinstance(place, dict) else list(range(len(place)))
    key = keys[int(rng.integers(len(keys)))]
    inner = place[key]
    if isinstance(inner, dict | list) and inner and rng.random() < 0.85:
        _spoil_at(inner, rng)
        return
    _do(place, key, keys[int(rng.integers(len(keys)))], rng)


def _do(place: Any, key: Any, other: Any, rng: Random) -> None:
    inner = place[key]
    actions: list[Callable[[], Any]] = [
        lambda: place.__setitem__(key, copy.deepcopy(VALUES[int(rng.integers(len(VALUES)))])),
        lambda: place.__setitem__(key, _nudged(inner, rng)),
        lambda: place.__delitem__(key),
        lambda: place.__setitem__(key, copy.deepcopy(place[other])),
        lambda: place.append(copy.deepcopy(inner)) if isinstance(place, list) else place.update({f"{key}x": inner}),
        lambda: inner.reverse() if isinstance(inner, list) else None,
        lambda: inner.extend(copy.deepcopy(inner) * 20) if isinstance(inner, list) else None,
    ]
    actions[int(rng.integers(len(actions)))]()


def _nudged(value: Any, rng: Random) -> Any:
    """A number a little or much off, of anything else a part."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value) + float(rng.choice([1e-9, 0.01, 0.3, 5.0, -5.0, -200.0]) * rng.normal())
    return value[: len(value) // 2] if isinstance(value, list | str) else value


def spoilt_yaml(data: bytes, rng: Random) -> bytes:
    """A yaml file with one or two lines given another value, removed, doubled, indented or exchanged."""
    lines = data.decode().splitlines()
    for _ in range(int(rng.integers(1, 3))):
        at = int(rng.integers(len(lines)))
        key = lines[at].partition(":")[0]
        value = YAML_VALUES[int(rng.integers(len(YAML_VALUES)))]
        line = lines[at]
        options = (f"{key}: {value}", "", f"{line}\n{line}", f"  {line}", f"- {line}", f"{key} {value}", value)
        lines[at] = options[int(rng.integers(len(options)))]
    return "\n".join(lines).encode()


def spoilt_image(data: bytes, rng: Random) -> bytes:
    """An image with another size, depth or kind in its header, chunks cut, doubled or added, or other pixels."""
    if rng.random() < 0.3:
        return _redrawn(data, rng)
    return _spoilt_png(data, rng) if data.startswith(b"\x89PNG") else spoilt_bytes(data[:16], rng) + data[16:]


def _spoilt_png(data: bytes, rng: Random) -> bytes:
    """Another number in the header, or another chunk behind it."""
    fields = list(struct.unpack(">IIBBBBB", data[16:29]))
    which = int(rng.integers(8))
    if which < 7:
        fields[which] = int(rng.choice(SIZES)) if which < 2 else int(rng.integers(256))
    chunks = [b"IHDR" + struct.pack(">IIBBBBB", *fields)]
    bomb = b"zTXta\0\0" + zlib.compress(bytes(10**6)) * 3
    chunks += [[b"acTL" + bytes(8), b"tRNS" + bytes(6), bomb][int(rng.integers(3))]] if which == 7 else []
    whole = b"".join(struct.pack(">I", len(one) - 4) + one + struct.pack(">I", zlib.crc32(one)) for one in chunks)
    return data[:8] + whole + data[33:]


def _redrawn(data: bytes, rng: Random) -> bytes:
    """The same picture in another mode, or a part of it."""
    image, out = Image.open(BytesIO(data)), BytesIO()
    left, top = (int(rng.integers(0, side)) for side in image.size)
    mode, size = str(rng.choice(["1", "L", "LA", "P", "RGB", "RGBA", "I;16"])), int(rng.integers(1, 400))
    image = image.convert(mode) if rng.random() < 0.5 else image.crop((left, top, left + size, top + size))
    image.save(out, "PNG")
    return out.getvalue()


STRUCTURE = {".json": spoilt_json, ".yaml": spoilt_yaml, ".png": spoilt_image, ".pgm": spoilt_image}


def spoilt(path: Path, rng: Random) -> bytes:
    """A file mutated in one of these ways."""
    data = path.read_bytes()
    return spoilt_bytes(data, rng) if rng.random() < 0.4 else STRUCTURE[path.suffix](data, rng)
