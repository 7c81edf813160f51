"""A snapshot in a file: a zip with the structure as JSON and the arrays as bytes, which any program can read.

`state.json` holds the format, its version, the version of the package and the plain data of `snapshot.encode`, in which
`{"@bytes": [type, shape, offset]}` stands for an array in `arrays.bin` (little-endian, the last index fastest).
"""

from __future__ import annotations

import io
import json
import math
import sys
import zipfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.format import dtype_to_descr

from mecp_env.core.errors import MecpError
from mecp_env.core.files import read_bytes, write_atomic
from mecp_env.core.snapshot import StateError

STRUCTURE, ARRAYS = "state.json", "arrays.bin"
MOST_BYTES = 4 * 2**30  # of a file, unpacked too: the covariance of 10,000 landmarks
# What is made of a file, for any file and per byte of it. Maps have arrays of 2 bytes per byte, and 1 part in 60 bytes.
ARRAY_BYTES, TEXT_BYTES, PARTS = (24 * 2**20, 5), (8 * 2**20, 2), (300_000, 0.08)
UNDATED = (1980, 1, 1, 0, 0, 0)  # equal states give equal files


class FileKind(NamedTuple):
    """What a file holds: the name and version of its format, and the version of the package that writes or reads it."""

    format: str
    version: int
    package: str


def save_snapshot(path: Path, kind: FileKind, data: Any) -> None:
    """Write plain data of `snapshot.encode`, atomically. Raises `OSError`."""
    arrays = io.BytesIO()
    content = kind._asdict() | {"state": _without_arrays(data, arrays)}
    text = json.dumps(content).encode()
    packed = _packed(text, arrays.getvalue(), zipfile.ZIP_DEFLATED)
    if arrays.tell() > most_of(ARRAY_BYTES, len(packed)):  # a large empty grid: it would be refused
        packed = _packed(text, arrays.getvalue(), zipfile.ZIP_STORED)
    write_atomic(path, packed)


def _packed(text: bytes, arrays: bytes, method: int) -> bytes:
    """The zip of the two parts."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, part in ((STRUCTURE, text), (ARRAYS, arrays)):
            member = zipfile.ZipInfo(name, UNDATED)
            member.external_attr = 0o644 << 16  # rights of the file when it is unpacked
            archive.writestr(member, part, method)
    return buffer.getvalue()


def load_snapshot(path: Path, kind: FileKind) -> Any:
    """The plain data that `save_snapshot` wrote. Raises `StateError` that names the file, field and value."""
    try:
        return _unpacked(read_bytes(path, MOST_BYTES), kind)
    except MecpError as error:
        raise StateError(f"{path}: {error}") from None
    except Exception as error:  # damaged bytes may raise anything
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise StateError(f"{path}: damaged ({reason:.120})") from None


def _unpacked(data: bytes, kind: FileKind) -> Any:
    """The plain data in a zip, whose checksums are compared on reading."""
    if not zipfile.is_zipfile(io.BytesIO(data)):
        raise StateError(f"no {kind.format}, or cut short")
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        if STRUCTURE not in archive.namelist():
            raise StateError(f"no {kind.format}: it holds {archive.namelist()[:4]!r:.80}")
        text = _member(archive, STRUCTURE, most_of(TEXT_BYTES, len(data)))
        check_parts(text, most_of(PARTS, len(data)))
        content = json.loads(text)
        check_header(content, kind)
        arrays = _Arrays(_member(archive, ARRAYS, most_of(ARRAY_BYTES, len(data))))
        return arrays.put_into(content["state"])


def most_of(limit: tuple[int, float], size: int) -> int:
    """How much may be made of a file of `size` bytes."""
    return min(int(limit[0] + limit[1] * size), MOST_BYTES)


def _member(archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    """The bytes of a part. Raises `StateError` for more than `most`, whatever size the file says."""
    member = archive.getinfo(name)
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise StateError(f"{name}: packed by method {member.compress_type}, expected deflate or none")
    with archive.open(member) as file:  # reading a given number of bytes unpacks no more than these
        found = file.read(member.file_size + 1) if member.file_size <= most else b""
    if len(found) != member.file_size or len(found) > most:
        raise StateError(f"{name}: it has {member.file_size} bytes unpacked, at most {most} in a file of this size")
    return found


def check_parts(text: bytes, most: int) -> None:
    """Raise `StateError` for JSON of more parts than `most`: values, with the weight of their memory."""
    parts = text.count(b",") + text.count(b"[") + 3 * text.count(b"{")
    if parts > most:
        raise StateError(f"{STRUCTURE}: it has {parts} parts, at most {most} in a file of this size")


def check_header(content: Any, kind: FileKind) -> None:
    """Raise `StateError` unless the file has this format and version."""
    if not isinstance(content, dict) or content.get("format") != kind.format:
        given = content.get("format") if isinstance(content, dict) else content
        raise StateError(f"format: {given!r:.40}, expected {kind.format!r}")
    if content.get("version") != kind.version:
        found = f"{content.get('version')!r:.20} (of mecp_env {content.get('package')!s:.20})"
        raise StateError(f"version: {found}, this mecp_env {kind.package} reads version {kind.version}")


def _without_arrays(data: Any, arrays: io.BytesIO) -> Any:
    """The data with a place in `arrays`, to which they are written, for each array."""
    if isinstance(data, np.ndarray):
        dtype, offset = data.dtype.newbyteorder("<"), arrays.tell()
        arrays.write(data.astype(dtype).tobytes())
        return {"@bytes": [dtype_to_descr(dtype), data.shape, offset]}
    if isinstance(data, list):
        return [_without_arrays(item, arrays) for item in data]
    if isinstance(data, dict):
        return {key: _without_arrays(item, arrays) for key, item in data.items()}
    return data


class _Arrays:
    """The arrays of a file; each byte may belong to one, so that they are no larger than the file says."""

    def __init__(self, data: bytes) -> None:
        self._data, self._left = data, len(data)

    def put_into(self, content: Any) -> Any:
        """The content, changed in place, with the arrays in their places."""
        if isinstance(content, list):
            content[:] = map(self.put_into, content)
        if not isinstance(content, dict):
            return content
        if content.keys() == {"@bytes"}:
            return self._array(*content["@bytes"])
        content.update({key: self.put_into(item) for key, item in content.items()})
        return content

    def _array(self, descr: Any, shape: list[int], offset: int) -> np.ndarray[Any, Any]:
        """The array of a type and shape from `offset` on, in the byte order of this machine."""
        fields = descr if isinstance(descr, str) else [(name, kind, *map(tuple, inner)) for name, kind, *inner in descr]
        dtype, count = np.dtype(fields), math.prod(shape)
        if dtype.hasobject or min(shape, default=0) < 0 or offset < 0:
            raise StateError(f"array: {descr!r:.40} {shape!r:.40} from {offset!r:.20} on")
        self._left -= count * dtype.itemsize
        if self._left < 0:
            raise StateError(f"{ARRAYS}: arrays of more bytes than there are")
        if not count:
            return np.empty(shape, dtype.newbyteorder("="))
        found = np.frombuffer(self._data, dtype, count, offset).reshape(shape)
        return found.astype(dtype.newbyteorder("="), copy=sys.byteorder != "little")
