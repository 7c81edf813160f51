"""Layouts by name, path, dict or object: read, checked, and refused with the field, the value and the bound."""

from __future__ import annotations

import json
import os
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any

from mecp_env.core.errors import LayoutError
from mecp_env.core.files import exists, read_bytes, text_of
from mecp_env.core.settings import guess
from mecp_env.world.checks import check_geometry
from mecp_env.world.doors import with_directions
from mecp_env.world.schema import Layout

LIBRARY = Path(__file__).parent / "library"
MAX_BYTES = 2_000_000

__all__ = ["MAX_BYTES", "Layout", "load_layout", "shipped_layouts"]


def shipped_layouts() -> tuple[str, ...]:
    """The names of the layouts that come with the package."""
    return tuple(sorted(path.stem for path in LIBRARY.glob("*.json")))


def load_layout(given: str | os.PathLike[str] | dict[str, Any] | Layout) -> Layout:
    """The layout of a shipped name, a path to a JSON file, a dict of its fields, or a `Layout`.

    Raises LayoutError naming the source, the field, the value and the bound: for a file that is missing, larger than
    2 MB or no JSON; for unknown, missing or wrong fields; for impossible geometry.
    """
    if isinstance(given, str) and given in shipped_layouts():
        return _shipped(given)
    return _checked(Path(given) if isinstance(given, os.PathLike) else given)


@cache
def _shipped(name: str) -> Layout:
    return _checked(name)


def _checked(given: str | Path | dict[str, Any] | Layout) -> Layout:
    try:
        layout = with_directions(_parse(given))
        check_geometry(layout)
        return layout
    except LayoutError as error:
        source = f"{given}: " if isinstance(given, str | Path) else ""
        raise LayoutError(f"{source}{error}") from None


def _parse(given: str | Path | dict[str, Any] | Layout) -> Layout:
    if isinstance(given, Layout):
        return given
    if isinstance(given, str | Path):
        given = decode_json(_read(given))
    if not isinstance(given, dict):
        raise LayoutError(f"expected a name, a path, a dict or a Layout, given {type(given).__name__}")
    if not all(isinstance(key, str) for key in given):
        raise LayoutError("keys of a layout are strings")
    return Layout(**given)


def _read(given: str | Path) -> bytes:
    """The bytes of the file that a shipped name or a path stands for."""
    names = shipped_layouts()
    path = LIBRARY / f"{given}.json" if str(given) in names else Path(given)
    if not exists(path) or path.is_dir():
        raise LayoutError(f"no such file; shipped layouts are {', '.join(names)}{guess(given, names)}")
    if path.suffix != ".json":
        raise LayoutError(f"a layout file ends in .json, given {path.suffix!r:.80}")
    return read_bytes(path, MAX_BYTES)


def decode_json(data: bytes) -> dict[str, Any]:
    """The object of a JSON text. Raises LayoutError for other JSON and for keys given twice."""
    try:
        document = json.loads(text_of(data), object_pairs_hook=_unique)
    except (ValueError, RecursionError) as error:  # neither text nor JSON, or nested too deeply
        raise LayoutError(f"no JSON: {error}") from None
    if not isinstance(document, dict):
        raise LayoutError(f"expected an object, given {type(document).__name__}")
    return document


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    document = dict(pairs)
    if len(document) < len(pairs):
        raise ValueError(f"{Counter(key for key, _ in pairs).most_common(1)[0][0]:.80}: given twice")
    return document
