"""The packed parts of a bag: how much each unpacks to, before any is unpacked at once.

A part (a chunk of records, a message, a whole file) begins with the mark of its packing.
"""

from __future__ import annotations

import bz2
import importlib
import io
import mmap
import re
import sqlite3
import struct
import tempfile
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import IO, Any

from mecp_env.core.errors import LogError

ROS1, MCAP = b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n"
BZ2, LZ4, ZSTD = b"BZh", b"\x04\x22\x4d\x18", b"\x28\xb5\x2f\xfd"
MARKS = re.compile(b"|".join(map(re.escape, (BZ2, LZ4, ZSTD))))
MESSAGE, CHUNK = 5, 6  # records of MCAP that may have a packed part,
BEFORE, NEAR = {MESSAGE: 22, CHUNK: 28}, 64  # whose mark is behind so many bytes, and within so many
RECORD = 9  # bytes of a record before its content
CHUNK_HEAD = 40  # bytes of a chunk before its records, but for the name of its packing
PIECE = 2**16  # bytes that are unpacked at once
MOST_MESSAGE = 2**24  # bytes of a message; one that unpacks to more is cut, and so damaged
Records = bytes | mmap.mmap


def opened(packed: IO[bytes], mark: bytes) -> IO[bytes]:
    """A packed file, to be read unpacked. Raises `ImportError` without the library that reads such bags."""
    file: IO[bytes] = _module(mark).open(packed)
    return file


def _module(mark: bytes) -> Any:
    if mark == BZ2:
        return bz2
    if mark == LZ4:
        return importlib.import_module("lz4.frame")
    try:
        return importlib.import_module("compression.zstd")
    except ImportError:
        return importlib.import_module("backports.zstd")


def unpacked_message(data: bytes) -> bytes:
    """The data of a message, which are packed where a part is read without the description of its bag."""
    return opened(io.BytesIO(data), ZSTD).read(MOST_MESSAGE) if bytes(data[:4]) == ZSTD else data


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
            whole.writelines(_pieces(packed, ZSTD, most))
            whole.flush()
            _check_file(Path(whole.name), most)
    elif path.suffix == ".db3":
        place = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
        with closing(sqlite3.connect(place, uri=True)) as database:
            for (data,) in database.execute("SELECT data FROM messages"):
                _unpacked(data, most)
    elif path.suffix in (".bag", ".mcap"):
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as records:
            _check_records(records, most)


def _check_records(records: Records, most: int) -> None:
    """Check the parts of a `.bag` of ROS 1, and of an MCAP file, which has packed messages also in its chunks."""
    if records[: len(ROS1)] == ROS1:
        for part in _parts_of_ros1(records):
            _unpacked(part, most)
    elif records[: len(MCAP)] == MCAP:
        for chunk in _parts_of_mcap(records, len(MCAP)):
            for part in _parts_of_mcap(_unpacked(chunk, most), 0):
                _unpacked(part, most)


def _parts_of_ros1(records: Records) -> Iterator[bytes]:
    """The data of each record that is packed, as a chunk may be."""
    at = len(ROS1)
    while at < len(records):
        at += 4 + int.from_bytes(records[at : at + 4], "little")  # the head
        end = at + 4 + int.from_bytes(records[at : at + 4], "little")
        if MARKS.match(records, at + 4):
            yield records[at + 4 : end]
        at = end


def _parts_of_mcap(records: Records, start: int) -> Iterator[bytes]:
    """The packed parts of the records from `start` on, and of those in chunks that are not packed."""
    while start + RECORD <= len(records):
        kind, length = struct.unpack_from("<BQ", records, start)
        start += RECORD
        near = min(NEAR, length) if kind in BEFORE else 0
        mark = MARKS.search(records, start + BEFORE.get(kind, 0), start + near)
        if mark:
            yield records[mark.start() : start + length]
        letters = int.from_bytes(records[start + 28 : start + 32], "little")
        start += CHUNK_HEAD + letters if kind == CHUNK and not mark else length


def _unpacked(data: bytes, most: int) -> bytes:
    """What a part unpacks to; nothing where it is not packed. Raises `LogError`."""
    mark = MARKS.match(data)
    return b"".join(_pieces(io.BytesIO(data), mark[0], most)) if mark else b""


def _pieces(packed: IO[bytes], mark: bytes, most: int) -> Iterator[bytes]:
    """What a packed file unpacks to. Raises `LogError` where that is more than `most` bytes."""
    left, file = most, opened(packed, mark)
    for piece in iter(partial(_next_piece, file), b""):
        left -= len(piece)
        if left < 0:
            raise LogError(f"a chunk unpacks to more than {most} bytes, too much for the size of the bag")
        yield piece


def _next_piece(file: IO[bytes]) -> bytes:
    """Some bytes of an opened file; none where it ends, or is damaged: other parts are checked all the same."""
    try:
        return file.read(PIECE)
    except Exception:  # damaged bytes may raise anything
        return b""
