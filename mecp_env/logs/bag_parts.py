"""The packed parts of a bag: how much each unpacks to, before any is unpacked at once.

A part (a chunk of records, a message, a whole file) begins with the mark of its packing, and tells where it ends.
"""

from __future__ import annotations

import bz2
import importlib
import io
import re
import sqlite3
import struct
import tempfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import IO, Any

from mecp_env.core.errors import LogError

ROS1, MCAP = b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n"
BZ2, LZ4, ZSTD = b"BZh", b"\x04\x22\x4d\x18", b"\x28\xb5\x2f\xfd"
MARKS = re.compile(b"|".join(map(re.escape, (BZ2, LZ4, ZSTD))))
MESSAGE, CHUNK = 5, 6  # records of MCAP that may have a packed part,
BEFORE, NEAR = {MESSAGE: 22, CHUNK: 28}, 64  # whose mark is behind so many bytes, and within so many
CHUNK_HEAD = 40  # bytes of a chunk before its records, but for the name of its packing
PIECE = 2**16  # bytes that are unpacked at once
MOST_MESSAGE = 2**24  # bytes of a message; one that unpacks to more is cut, and so damaged


def unpacker_of(data: bytes) -> Any:
    """What unpacks a part piece by piece. Raises `ImportError` without the library that reads such bags."""
    if data.startswith(BZ2):
        return bz2.BZ2Decompressor()
    if data.startswith(LZ4):
        return importlib.import_module("lz4.frame").LZ4FrameDecompressor()
    try:
        zstd = importlib.import_module("compression.zstd")
    except ImportError:
        zstd = importlib.import_module("backports.zstd")
    return zstd.ZstdDecompressor()


def unpacked_message(data: bytes) -> bytes:
    """The data of a message, which are packed where a part is read without the description of its bag."""
    packed = bytes(data[:4]) == ZSTD
    return unpacker_of(ZSTD).decompress(data, max_length=MOST_MESSAGE) if packed else data


def check_parts(path: Path, most: int) -> None:
    """Raise `LogError` where a part of a bag unpacks to more than `most` bytes."""
    try:
        for file in [path] if path.is_file() else sorted(path.iterdir()):
            _check_file(file, most)
    except LogError:
        raise
    except Exception:  # damaged bytes may raise anything; the reader of the bag says so
        return


def _check_file(path: Path, most: int) -> None:
    if path.suffix == ".zstd":
        with tempfile.NamedTemporaryFile(suffix=path.with_suffix("").suffix) as whole, path.open("rb") as packed:
            whole.writelines(_unpacked(packed, most))
            whole.flush()
            _check_file(Path(whole.name), most)
    elif path.suffix == ".db3":
        place = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
        with closing(sqlite3.connect(place, uri=True)) as database:
            for (data,) in database.execute("SELECT data FROM messages"):
                _check_part(io.BytesIO(data), most)
    elif path.suffix in (".bag", ".mcap"):
        with path.open("rb") as file:
            _check_records(file, most)


def _check_records(file: IO[bytes], most: int) -> None:
    """Check the parts of a `.bag` of ROS 1, and of an MCAP file, which has packed messages also in its chunks."""
    start = file.read(len(ROS1))
    if start == ROS1:
        for _ in _chunks_of_ros1(file):
            _check_part(file, most)
    elif start.startswith(MCAP):
        for _ in _parts_of_mcap(file, len(MCAP)):
            records = _check_part(file, most)
            for _ in _parts_of_mcap(records, 0):
                _check_part(records, most)


def _chunks_of_ros1(file: IO[bytes]) -> Iterator[None]:
    """Stop the file at the data of each record: a chunk, perhaps packed, or others."""
    while len(length := file.read(4)) == 4:
        file.seek(int.from_bytes(length, "little"), io.SEEK_CUR)  # the head
        size = int.from_bytes(file.read(4), "little")
        start = file.tell()
        yield
        file.seek(start + size)


def _parts_of_mcap(file: IO[bytes], start: int) -> Iterator[None]:
    """Stop the file at each packed part among the records from `start` on, and in chunks that are not packed."""
    while file.seek(start) == start and len(head := file.read(9)) == 9:
        kind, length = struct.unpack("<BQ", head)
        near = file.read(NEAR) if kind in BEFORE else b""
        mark = MARKS.search(near[:length], BEFORE.get(kind, 0))
        start += 9
        if mark:
            file.seek(start + mark.start())
            yield
        letters = int.from_bytes(near[28:32], "little")
        start += CHUNK_HEAD + letters if kind == CHUNK and not mark else length


def _check_part(file: IO[bytes], most: int) -> IO[bytes]:
    """What the file has unpacked, from where it is; nothing where that is not packed. Raises `LogError`."""
    place = file.tell()
    unpacked = io.BytesIO()
    packed = MARKS.match(file.read(4))
    file.seek(place)
    unpacked.writelines(_unpacked(file, most) if packed else ())
    return unpacked


def _unpacked(packed: IO[bytes], most: int) -> Iterator[bytes]:
    """What the frames that follow each other in a part unpack to. Raises `LogError` where that is more than `most`."""
    left, data = most, packed.read(PIECE)
    unpacker = unpacker_of(data)
    while data or not unpacker.needs_input:
        piece = unpacker.decompress(data, max_length=PIECE)
        left -= len(piece)
        if left < 0:
            raise LogError(f"a chunk unpacks to more than {most} bytes, too much for the size of the bag")
        yield piece
        if unpacker.eof:  # several frames may follow each other
            data = (unpacker.unused_data or b"") + packed.read(len(ZSTD))
            if not MARKS.match(data):
                return
            unpacker = unpacker_of(data)
        else:
            data = packed.read(PIECE) if unpacker.needs_input else b""
