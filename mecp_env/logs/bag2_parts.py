"""The packed parts of a ROS 2 bag: chunks of MCAP files, messages, and whole files."""

from __future__ import annotations

import bz2
import importlib
import io
import sqlite3
import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

MAGIC, ZSTD = b"\x89MCAP0\r\n", b"\x28\xb5\x2f\xfd"
MESSAGE, CHUNK = 5, 6  # records of MCAP
STAMPS = 22  # bytes of a message before its data: channel, number and two times
PIECE = 2**16
MOST_MESSAGE = 2**24  # bytes of a message; one that unpacks to more is cut, and so damaged
SQLITE = ".db3"

Part = tuple[str, bytes]  # packing and bytes


class TooMuch(Exception):
    """A part unpacks to more than it may."""


def unpacker_of(packing: str) -> Any:
    """What unpacks piece by piece. Raises `ImportError` without the library that reads such bags."""
    if packing == "lz4":
        return importlib.import_module("lz4.frame").LZ4FrameDecompressor()
    if packing == "bz2":
        return bz2.BZ2Decompressor()
    try:
        zstd = importlib.import_module("compression.zstd")
    except ImportError:
        zstd = importlib.import_module("backports.zstd")
    return zstd.ZstdDecompressor()


def unpacked_message(data: bytes) -> bytes:
    """The data of a message, which are packed where a part is read without the description of its bag."""
    packed = bytes(data[:4]) == ZSTD
    unpacked: bytes = unpacker_of("zstd").decompress(data, max_length=MOST_MESSAGE) if packed else data
    return unpacked


def packed_parts(path: Path, most: int) -> Iterator[Part]:
    """The packed parts of all files of a bag. Raises `TooMuch` for a packed file of more than `most` bytes."""
    for file in [path] if path.is_file() else sorted(path.iterdir()):
        if file.suffix == SQLITE:
            yield from _rows(file)
        elif file.suffix == ".mcap":
            with file.open("rb") as records:
                yield from _mcap(records, most)
        elif file.suffix == ".zstd":
            yield from _packed_file(file, most)


def _packed_file(path: Path, most: int) -> Iterator[Part]:
    """The parts of a packed file, unpacked into a temporary one."""
    with tempfile.NamedTemporaryFile(suffix=path.with_suffix("").suffix) as unpacked:
        for piece in _pieces(path):
            unpacked.write(piece)
            if unpacked.tell() > most:
                raise TooMuch
        unpacked.flush()
        unpacked.seek(0)
        yield from _rows(Path(unpacked.name)) if unpacked.name.endswith(SQLITE) else _mcap(unpacked, most)


def _pieces(path: Path) -> Iterator[bytes]:
    """What a packed file unpacks to."""
    unpacker = unpacker_of("zstd")
    with path.open("rb") as packed:
        while not unpacker.eof:
            data = packed.read(PIECE) if unpacker.needs_input else b""
            if unpacker.needs_input and not data:
                return  # cut short
            yield unpacker.decompress(data, PIECE)


def _rows(path: Path) -> Iterator[Part]:
    """The packed messages of a database."""
    database = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
    try:
        for (data,) in database.execute("SELECT data FROM messages"):
            if bytes(data[:4]) == ZSTD:
                yield "zstd", bytes(data)
    finally:
        database.close()


def _mcap(file: IO[bytes], most: int) -> Iterator[Part]:
    """The chunks of an MCAP file, and the packed messages in and between them, up to the first damaged record."""
    if file.read(len(MAGIC)) != MAGIC:
        return
    for kind, body in _records(file, len(MAGIC)):
        if kind == MESSAGE:
            yield from _message(body)
            continue
        packing, data = _chunk(body)
        if packing:
            yield packing, data
            data = unpacker_of(packing).decompress(data, max_length=most)
        for inner, message in _records(io.BytesIO(data)):
            yield from _message(message) if inner == MESSAGE else ()


def _message(body: bytes) -> Iterator[Part]:
    """The data of a message, where they are packed."""
    if body[STAMPS : STAMPS + 4] == ZSTD:
        yield "zstd", body[STAMPS:]


def _records(file: IO[bytes], start: int = 0) -> Iterator[tuple[int, bytes]]:
    """The kind and the body of each record."""
    end = file.seek(0, io.SEEK_END)
    file.seek(start)
    while len(head := file.read(9)) == 9:
        kind, length = struct.unpack("<BQ", head)
        after = min(file.tell() + length, end)  # what is cut short has no more
        if kind in (MESSAGE, CHUNK):
            yield kind, file.read(after - file.tell())
        file.seek(after)


def _chunk(body: bytes) -> Part:
    """The packing and the bytes of a chunk."""
    (letters,) = struct.unpack_from("<I", body, 28)
    packing = body[32 : 32 + letters].decode("latin-1")
    return packing, body[40 + letters :]
