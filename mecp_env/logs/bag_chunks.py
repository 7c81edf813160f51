"""The packed parts of a bag: how much they unpack to, before the whole of one is unpacked at once."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

from mecp_env.core.errors import LogError
from mecp_env.logs.bag2_parts import TooMuch, packed_parts, unpacker_of

MAGIC = b"#ROSBAG V2.0\n"
CHUNK, COMPRESSION, OP = b"\x05", b"compression=", b"op="
PIECE = 2**16


def check_chunks(path: Path, most: int) -> None:
    """Raise `LogError` where a packed chunk of a `.bag` unpacks to more than `most` bytes; of a ROS 2 bag any part."""
    found = _packed_chunks(path) if path.suffix == ".bag" and path.is_file() else packed_parts(path, most)
    try:
        for packing, data in found:
            if unpacked_size(packing, data, most) > most:
                raise TooMuch
    except TooMuch:
        raise LogError(f"a chunk unpacks to more than {most} bytes, too much for the size of the bag") from None
    except Exception:  # damaged bytes may raise anything; the reader of the bag says so
        return


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


def unpacked_size(packing: str, data: bytes, most: int) -> int:
    """Bytes that a part unpacks to, counted piece by piece up to a few more than `most`."""
    size = 0
    while data and size <= most:
        unpacker = unpacker_of(packing)
        size += len(unpacker.decompress(data, max_length=PIECE))
        while not unpacker.eof and size <= most:
            piece = unpacker.decompress(b"", max_length=PIECE)
            if not piece:
                return size
            size += len(piece)
        data = unpacker.unused_data if unpacker.eof and packing == "zstd" else b""  # several frames follow each other
    return size
