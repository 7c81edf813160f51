"""Modules of the user that register custom parts by name; other processes import them, too, before they work."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterable
from pathlib import Path

from mecp_env.core.errors import ConfigError
from mecp_env.core.provenance import checksum

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
