"""Paths that a user gave, whose names may be impossible (too long, or with a NUL byte); files written whole or not."""

from __future__ import annotations

import os
from pathlib import Path

from mecp_env.core.errors import LayoutError


def exists(path: str | Path) -> bool:
    """True when there is a file or folder; False, too, for a name that no file can have."""
    try:
        return Path(path).exists()
    except (OSError, ValueError):
        return False


def is_folder(path: str | Path) -> bool:
    """True when there is a folder; False, too, for a name that no folder can have."""
    return exists(path) and Path(path).is_dir()


def read_bytes(path: Path, most: int) -> bytes:
    """The bytes of a file. Raises LayoutError for one that is missing, no plain file, or larger than `most`."""
    try:
        if not path.is_file():
            raise LayoutError("no such file")
        size = path.stat().st_size
        if size > most:
            raise LayoutError(f"the file has {size} bytes, at most {most}")
        with path.open("rb") as file:
            return file.read(size)
    except (OSError, ValueError) as error:  # unreadable; a NUL byte in the name
        raise error if isinstance(error, LayoutError) else LayoutError(f"cannot be read: {error}") from None


def write_atomic(path: Path, data: bytes) -> None:
    """Write a file so that after a crash at any time the old or the new one exists, never a part.

    Raises `OSError` that names it, as when the disk is full.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        temporary.unlink(missing_ok=True)
    if os.name == "posix":  # make the name last, too
        handle = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
