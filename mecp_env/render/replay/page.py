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
from mecp_env.core.paths import write_atomic

VERSION = 1
AGAIN = "run the command that made it again"
MARK = re.compile(r"\{\{(\w+)\}\}")
# What is made of a page, for any page and per byte of it; pages have up to 4.7 bytes and 1.3 values per byte.
JSON_BYTES, VALUES = (2**24, 8), (300_000, 1.6)
PACKED = re.compile(r'<script id="run" type="text/plain" data-version="(\d+)">([A-Za-z0-9+/=\s]*)</script>')


class ReplayError(MecpError):
    """A page that is no replay, is damaged, or was made by a later version."""


def write_page(run: dict[str, Any], path: Path) -> None:
    """Write the page that plays a run (`Recorder.run`). Raises `OSError`."""
    packed = base64.b64encode(gzip.compress(json.dumps(run, separators=(",", ":")).encode(), 9, mtime=0)).decode()
    parts = {name: (files(__package__) / name).read_text("utf-8") for name in ("page.html", "style.css", "player.js")}
    texts = {"title": html.escape(run["title"]), "version": str(VERSION), "run": packed}
    texts |= {"style": parts["style.css"], "player": parts["player.js"]}
    page = MARK.sub(lambda mark: texts[mark[1]], parts["page.html"])  # at once: a text may hold what looks like a mark
    write_atomic(path, page.encode("utf-8", "replace"))


def read_page(path: Path) -> dict[str, Any]:
    """The run in a page. Raises `ReplayError` for a file that is none, `OSError` for one that cannot be read."""
    found = PACKED.search(path.read_text("utf-8", errors="replace"))
    if found is None:
        raise ReplayError(f"{path}: no replay of mecp_env, or a part of it is missing; {AGAIN}")
    if int(found[1]) > VERSION:
        raise ReplayError(f"{path}: version {found[1]} of the replay, this mecp_env reads up to {VERSION}; update it")
    try:
        run = json.loads(unpacked(base64.b64decode(found[2], validate=True)))
    except (ValueError, OSError, EOFError, zlib.error, RecursionError, MemoryError) as error:
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
    values = text.count(b",") + 2 * text.count(b"[") + 4 * text.count(b"{")
    if len(text) > most or values > VALUES[0] + VALUES[1] * len(packed):
        raise ValueError(f"{len(packed)} bytes that make at least {len(text)} bytes and {values} values")
    return text
