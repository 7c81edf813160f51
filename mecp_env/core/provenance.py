"""Where results come from: the commit, and what else they depend on beside the configuration.

Modules of the user that register custom parts by name are imported by other processes, too, before they work.
"""

from __future__ import annotations

import hashlib
import importlib
import platform
import subprocess
import sys
from collections.abc import Iterable
from functools import cache
from importlib.metadata import version
from pathlib import Path

from mecp_env.core.errors import ConfigError

__version__ = "0.1.0"


_imported: dict[str, None] = {}  # in their order


def import_modules(names: Iterable[str]) -> None:
    """Import modules, also from the working directory. Raises `ConfigError` for one that is missing or that raises."""
    for name in names:
        here = str(Path.cwd())
        if here not in sys.path:
            sys.path.append(here)
        try:
            importlib.import_module(name)
        except Exception as error:  # code of the user may raise anything
            hint = f"; a module is named as `import` names it: {name[:-3]}" if name.endswith(".py") else ""
            raise ConfigError(f"--with {name:.80}: {type(error).__name__}: {error}{hint}") from error
        _imported[name] = None


def imported_modules() -> tuple[str, ...]:
    """The names of the modules that `import_modules` has imported in this process."""
    return tuple(_imported)


def checksums() -> dict[str, str]:
    """Of the file of each of these modules: results depend on it."""
    files = {name: sys.modules[name].__file__ for name in _imported}
    return {f"module {name}": checksum(Path(file).read_bytes()) for name, file in files.items() if file}


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
