"""Where results come from: the commit, and what else they depend on beside the configuration."""

from __future__ import annotations

import hashlib
import platform
import subprocess
from collections.abc import Iterable
from functools import cache
from importlib.metadata import version
from pathlib import Path

PACKAGE = Path(__file__).parents[1]
CODE = (".py", ".json")  # suffixes of the files that results depend on: code, layouts, descriptions of weights


@cache
def commit() -> str:
    """The commit of the clone that this runs from, with a `+` if tracked files have changed; "" elsewhere."""
    try:
        changed = "+" if _git("status", "--porcelain", "--untracked-files=no") else ""
        return _git("rev-parse", "HEAD") + changed
    except (OSError, subprocess.SubprocessError):
        return ""


def _git(*words: str) -> str:
    line = ["git", "-C", str(PACKAGE), *words]
    return subprocess.run(line, capture_output=True, text=True, timeout=10, check=True).stdout.strip()


def dependencies(*folders: Path) -> dict[str, str]:
    """The code of the package and in other folders, libraries and kind of machine: equal ones give equal results."""
    files = sorted(path for folder in (PACKAGE, *folders) for path in folder.rglob("*.*") if path.suffix in CODE)
    return {
        "checksum of the code": checksum(b"".join(path.read_bytes() for path in files)),
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "numba")},
        "machine": f"{platform.system()} {platform.machine()}",
    }


def checksum(data: bytes) -> str:
    """16 hexadecimal digits."""
    return checksum_of_parts([data])


def checksum_of_parts(parts: Iterable[bytes]) -> str:
    """That of all of them together, which need not be in memory at once."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.hexdigest()[:16]
