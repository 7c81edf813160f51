"""Records of drives in files: NumPy archives (.npz) that run no code when they are read, whole or not at all.

`header` holds JSON as bytes: format, version, package, what the record is, the lengths of its arrays, and `content`,
the SHA-256 of all the rest. The header is checked before any array is read, then the arrays against their lengths, and
the content at the end.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from pydantic import ConfigDict, TypeAdapter, ValidationError

from mecp_env import __version__
from mecp_env.core.errors import MecpError
from mecp_env.core.files import read_bytes, write_atomic
from mecp_env.core.snapshot import FileKind, check_header

KIND = FileKind("mecp_env record", 1, __version__)
HEADER = "header"
MOST_BYTES, MOST_HEADER_BYTES = 2**31, 2**26  # of the file, and unpacked
SHAPES: dict[str, tuple[str, tuple[int | str, ...]]] = {  # type and shape; the letters are lengths in the header
    "ranges": ("<f8", ("scans", "sweeps", "beams")),  # m
    "hit": ("|b1", ("scans", "sweeps", "beams")),
    "bearings": ("<f8", ("sweeps", "beams")),  # rad, those of every scan
    "arcs": ("<i8", ("scans",)),  # readings of the odometry before the scan, -1: at rest at the start
    "increments": ("<f8", ("readings", 2)),  # m, rad; those of all scans one after the other
    "increment_cov": ("<f8", ("readings", 2, 2)),
    "bumper": ("|b1", ("scans",)),
    "T_world_robot": ("<f8", ("scans", 3)),  # m, rad: true pose of each scan
}

Arrays = dict[str, np.ndarray[Any, Any]]


class RecordError(MecpError):
    """A record is damaged, of another format or version, too large, or of another drive."""


@dataclass(frozen=True, slots=True)
class Header:
    """What a record is, beside format and version."""

    __pydantic_config__ = ConfigDict(extra="forbid", strict=True)  # type: ignore[misc]

    course: dict[str, Any]  # what was driven: layout, seed, fields of the environment
    layout: dict[str, Any]  # the building, as a layout file has it
    laser: dict[str, Any]  # where it sits and what it sees: `LaserView`
    max_range_m: float
    slam: dict[str, Any]  # the estimator during the drive
    made_by: dict[str, str]  # code, libraries and machine
    lengths: dict[str, int]  # scans, sweeps, beams, readings


HEADERS = TypeAdapter(Header)


def save_record(path: Path, header: Header, arrays: Arrays) -> None:
    """Write a record, whole or not at all. Raises `OSError`."""
    plain = {**KIND._asdict(), **asdict(header)}
    plain["content"] = content_of(plain, arrays)
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **{HEADER: np.frombuffer(json.dumps(plain).encode(), np.uint8), **arrays})
    write_atomic(path, buffer.getvalue())


def load_record(path: Path) -> tuple[Header, Arrays]:
    """What `save_record` wrote. Raises `RecordError` that names the file and what is wrong."""
    with opened(path) as archive:
        plain, header = _header(archive)
        arrays = {name: _array(archive, name, header.lengths) for name in SHAPES}
        if plain.pop("content") != content_of(plain, arrays):
            raise RecordError("damaged: its content hash is that of another content")
        return header, arrays


def load_header(path: Path) -> tuple[Header, str]:
    """The header of a record, and its content hash; the arrays stay unread. Raises `RecordError`."""
    with opened(path) as archive:
        plain, header = _header(archive)
        return header, str(plain["content"])


@contextmanager
def opened(path: Path) -> Iterator[zipfile.ZipFile]:
    """The archive in a file; whatever is wrong with it is a `RecordError` that names the file."""
    try:
        data = io.BytesIO(read_bytes(path, MOST_BYTES))
        if not zipfile.is_zipfile(data):
            raise RecordError(f"no {KIND.format}, or cut short")
        with zipfile.ZipFile(data) as archive:
            yield archive
    except MecpError as error:
        raise RecordError(f"{path}: {error}") from None
    except Exception as error:  # damaged bytes may raise anything
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise RecordError(f"{path}: damaged ({reason:.120})") from None


def content_of(plain: Mapping[str, Any], arrays: Arrays) -> str:
    """SHA-256, 64 hexadecimal digits, of a header without its `content`, and of the arrays."""
    digest = hashlib.sha256(json.dumps(plain, sort_keys=True).encode())
    for name in SHAPES:
        digest.update(np.ascontiguousarray(arrays[name]).data)
    return digest.hexdigest()


def _header(archive: zipfile.ZipFile) -> tuple[dict[str, Any], Header]:
    """The header as it is, and checked. Raises `RecordError`, and whatever damaged bytes raise."""
    names = archive.namelist()
    if f"{HEADER}.npy" not in names:
        raise RecordError(f"no {KIND.format}: it holds {', '.join(names) or 'nothing':.80}")
    sizes = {member.filename: member.file_size for member in archive.infolist()}
    if sum(sizes.values()) > MOST_BYTES or sizes[f"{HEADER}.npy"] > MOST_HEADER_BYTES:
        raise RecordError(f"it has {sum(sizes.values())} bytes unpacked, at most {MOST_BYTES}")
    raw = npy.read_array(io.BytesIO(archive.read(f"{HEADER}.npy")), allow_pickle=False)
    plain = json.loads(raw.tobytes())
    check_header(plain, KIND)
    missing = [name for name in SHAPES if f"{name}.npy" not in names]
    if missing:
        raise RecordError(f"damaged: no {', '.join(missing)}")
    rest = {name: value for name, value in plain.items() if name not in (*KIND._fields, "content")}
    try:
        return plain, HEADERS.validate_json(json.dumps(rest))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise RecordError(f"damaged: header.{'.'.join(map(str, first['loc']))}: {first['msg']}") from None


def _array(archive: zipfile.ZipFile, name: str, lengths: Mapping[str, int]) -> np.ndarray[Any, Any]:
    """An array of the expected type and shape. Raises `RecordError`, and whatever damaged bytes raise."""
    kind, letters = SHAPES[name]
    shape, dtype = tuple(lengths[size] if isinstance(size, str) else size for size in letters), np.dtype(kind)
    found = npy.read_array(io.BytesIO(archive.read(f"{name}.npy")), allow_pickle=False)
    if (found.shape, found.dtype) != (shape, dtype):
        raise RecordError(f"damaged: {name}: {found.dtype} {found.shape}, expected {dtype} {shape}")
    return np.ascontiguousarray(found, dtype.newbyteorder("="))
