"""The page of a replay: player, style and the packed run in one HTML file that needs no network."""

from __future__ import annotations

import base64
import gzip
import html
import io
import json
import re
import zlib
from importlib.resources import files
from pathlib import Path
from typing import Any

from mecp_env.core.errors import MecpError
from mecp_env.core.json_text import loads
from mecp_env.core.paths import write_atomic

VERSION = 1
AGAIN = "run the command that made it again"
MARK = re.compile(r"\{\{(\w+)\}\}")
# What is made of a run, for any one and per byte of it as it is packed; of honest ones 5.4 bytes of text, 56 of values.
JSON_BYTES, VALUE_BYTES = (2**23, 8), (2**25, 62)
PACKED = re.compile(rb'<script id="run" type="text/plain" data-version="(\d{1,9})">([A-Za-z0-9+/=\s]*)</script>')


class ReplayError(MecpError):
    """A page that is no replay, is damaged, or was made by a later version."""


def write_page(run: dict[str, Any], path: Path) -> None:
    """Write the page that plays a run (`Recorder.run`). Raises `OSError`."""
    _write(run["title"], gzip.compress(json.dumps(run, separators=(",", ":")).encode(), 9, mtime=0), path)


def _write(title: str, packed: bytes, path: Path) -> None:
    """The page of a run that is packed."""
    parts = {name: (files(__package__) / name).read_text("utf-8") for name in ("page.html", "style.css", "player.js")}
    texts = {"title": html.escape(title), "version": str(VERSION), "run": base64.b64encode(packed).decode()}
    texts |= {"style": parts["style.css"], "player": parts["player.js"]}
    page = MARK.sub(lambda mark: texts[mark[1]], parts["page.html"])  # at once: a text may hold what looks like a mark
    write_atomic(path, page.encode("utf-8", "replace"))


def read_page(path: Path) -> dict[str, Any]:
    """The run in a page. Raises `ReplayError` for a file that is none, `OSError` for one that cannot be read."""
    return _checked(packed_run(path), path)


def play_again(path: Path, out: Path) -> int:
    """Write the page with the player of this version; the number of its frames. Raises as `read_page`."""
    packed = packed_run(path)
    run = _checked(packed, path)
    title, count = run["title"], len(run["frames"])
    del run  # it may be large
    _write(title, packed, out)
    return count


def packed_run(path: Path) -> bytes:
    """The run in a page, as it is packed. Raises `ReplayError` and `OSError`."""
    found = PACKED.search(path.read_bytes())
    if found is None:
        raise ReplayError(f"{path}: no replay of mecp_env, or a part of it is missing; {AGAIN}")
    if int(found[1]) > VERSION:
        version = found[1].decode()
        raise ReplayError(
            f"{path}: version {version:.20} of the replay, this mecp_env reads up to {VERSION}; update it"
        )
    try:
        return base64.b64decode(found[2], validate=True)
    except ValueError as error:
        raise ReplayError(f"{path}: the run in it is damaged ({error!s:.200}); {AGAIN}") from error


def _checked(packed: bytes, path: Path) -> dict[str, Any]:
    """The run that is packed. Raises `ReplayError`."""
    try:
        run = loads(unpacked(packed), VALUE_BYTES[0] + VALUE_BYTES[1] * len(packed))
    except (ValueError, OSError, EOFError, zlib.error, MemoryError) as error:
        raise ReplayError(f"{path}: the run in it is damaged ({error!s:.200}); {AGAIN}") from error
    if not isinstance(run, dict) or not isinstance(run.get("frames"), list) or not run["frames"]:
        raise ReplayError(f"{path}: the run in it has no frames")
    if not isinstance(run.get("title"), str):
        raise ReplayError(f"{path}: title: {type(run.get('title')).__name__}, expected a text; {AGAIN}")
    return run


def unpacked(packed: bytes) -> bytes:
    """The JSON of a run. Raises `ValueError` where it would take far more memory than any run of its size."""
    most = int(JSON_BYTES[0] + JSON_BYTES[1] * len(packed))
    with gzip.open(io.BytesIO(packed)) as file:
        text = file.read(most + 1)
    if len(text) > most:
        raise ValueError(f"{len(packed)} bytes that make more than {most} bytes of text")
    return text
