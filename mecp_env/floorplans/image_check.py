"""Whether an image file holds what its header says; Pillow fills up what is missing and ignores what is left."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

from PIL.ImageFile import ImageFile

from mecp_env.core.errors import LayoutError

CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # of each colour type of PNG
ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
SIGNATURE = 8  # bytes
AFTER_PGM = 2  # bytes that may follow the pixels, a line end
RAW = {b"P4": 1, b"P5": 8, b"P6": 24}  # bits per pixel


def check_content(data: bytes, image: ImageFile) -> None:
    """Raise LayoutError where `data` holds fewer or more pixels than the header of `image`, or a damaged chunk."""
    if image.format == "PNG":
        _check_png(data)
    elif data[:2] in RAW and image.tile:
        width, height = image.size
        given = len(data) - int(image.tile[0][2])
        expected = height * ((width * RAW[data[:2]] + 7) // 8)
        _require(given, expected, AFTER_PGM, image.size)


def _check_png(data: bytes) -> None:
    chunks = list(_chunks(data))
    width, height, depth, colour, _, _, interlaced = struct.unpack(">IIBBBBB", chunks[0][1][:13])
    bits = CHANNELS[colour] * depth
    passes = ADAM7 if interlaced else ((0, 0, 1, 1),)
    sizes = [(-(-(width - x) // dx), -(-(height - y) // dy)) for x, y, dx, dy in passes]
    expected = sum(rows * (1 + (columns * bits + 7) // 8) for columns, rows in sizes if rows > 0 and columns > 0)
    pixels = zlib.decompressobj().decompress(b"".join(body for kind, body in chunks if kind == b"IDAT"), expected + 1)
    _require(len(pixels), expected, 0, (width, height))


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Type and content of each chunk of a PNG. Raises LayoutError for a damaged one, and without the last one."""
    at = SIGNATURE
    while at + 12 <= len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        body, checksum = data[at + 4 : at + 8 + length], data[at + 8 + length : at + 12 + length]
        if checksum != struct.pack(">I", zlib.crc32(body)):
            raise LayoutError(f"damaged: wrong checksum of the chunk {body[:4]!r} at byte {at}")
        yield body[:4], body[4:]
        at += 12 + length
        if body[:4] == b"IEND":
            return
    raise LayoutError(f"truncated: {len(data)} bytes without the chunk IEND")


def _require(given: int, expected: int, more: int, size: tuple[int, int]) -> None:
    if not expected <= given <= expected + more:
        amount = f"{given}" if given <= expected else f"more than {expected}"
        raise LayoutError(f"{amount} bytes of pixels, {expected} expected by its header ({size[0]} x {size[1]} pixels)")
