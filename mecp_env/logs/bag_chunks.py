"""The packed chunks of a ROS 1 bag: how much they unpack to, before the whole of one is unpacked at once."""

from __future__ import annotations

import bz2
import importlib
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mecp_env.core.errors import LogError

MAGIC = b"#ROSBAG V2.0\n"
CHUNK, COMPRESSION, OP = b"\x05", b"compression=", b"op="
PIECE = 2**16


def check_chunks(path: Path, most: int) -> None:
    """Raise `LogError` where a packed chunk of a `.bag` unpacks to more than `most` bytes."""
    if path.suffix != ".bag" or not path.is_file():
        return
    for packing, data in _packed_chunks(path):
        try:
            size = _unpacked_size(packing, data, most)
        except Exception:  # damaged bytes may raise anything; the reader of the bag says so
            return
        if size > most:
            raise LogError(f"a chunk unpacks to more than {most} bytes, too much for the size of the bag")


def _packed_chunks(path: Path) -> Iterator[tuple[str, bytes]]:
    """The packing and the bytes of each chunk that is packed, up to the first damaged record."""
    end = path.stat().st_size
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            return
        while len(word := file.read(4)) == 4:
            length = struct.unpack("<I", word)[0]
            head = file.read(length if length < PIECE else 0)
            word = file.read(4)
            if not head or len(word) < 4 or file.tell() + (size := struct.unpack("<I", word)[0]) > end:
                return
            fields = _fields(head)
            packing = fields.get(COMPRESSION, b"none").decode("latin-1")
            if fields.get(OP) == CHUNK and packing in ("bz2", "lz4"):
                yield packing, file.read(size)
            else:
                file.seek(size, 1)


def _fields(head: bytes) -> dict[bytes, bytes]:
    """Those of the header of a record that are of use, by their names with the sign of equality."""
    found, at = dict[bytes, bytes](), 0
    while at + 4 <= len(head):
        length = struct.unpack_from("<I", head, at)[0]
        text, at = head[at + 4 : at + 4 + length], at + 4 + length
        found |= {name: text[len(name) :] for name in (OP, COMPRESSION) if text.startswith(name)}
    return found


def _unpacked_size(packing: str, data: bytes, most: int) -> int:
    """Bytes that a chunk unpacks to, counted piece by piece up to a few more than `most`."""
    unpacker: Any = bz2.BZ2Decompressor()
    if packing == "lz4":
        unpacker = importlib.import_module("lz4.frame").LZ4FrameDecompressor()
    size = len(unpacker.decompress(data, max_length=PIECE))
    while not unpacker.eof and size <= most:
        piece = unpacker.decompress(b"", max_length=PIECE)
        if not piece:
            break
        size += len(piece)
    return size
