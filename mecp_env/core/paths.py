"""Paths that a user gave, whose names may be impossible: too long, or with a NUL byte."""

from __future__ import annotations

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
            return file.read(most)
    except (OSError, ValueError) as error:  # unreadable; a NUL byte in the name
        raise error if isinstance(error, LayoutError) else LayoutError(f"cannot be read: {error}") from None
