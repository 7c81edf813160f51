"""Questions about paths that a user gave, whose names may be impossible: too long, or with a NUL byte."""

from __future__ import annotations

from pathlib import Path


def exists(path: str | Path) -> bool:
    """True when there is a file or folder; False, too, for a name that no file can have."""
    try:
        return Path(path).exists()
    except (OSError, ValueError):
        return False


def is_folder(path: str | Path) -> bool:
    """True when there is a folder; False, too, for a name that no folder can have."""
    return exists(path) and Path(path).is_dir()
