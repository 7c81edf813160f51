"""The page of a replay: player, style and the packed run in one HTML file that needs no network."""

from __future__ import annotations

import base64
import gzip
import html
import json
import re
import zlib
from importlib.resources import files
from pathlib import Path
from typing import Any

from mecp_env.core.errors import MecpError

VERSION = 1
AGAIN = "run the command that made it again"
PACKED = re.compile(r'<script id="run" type="text/plain" data-version="(\d+)">([A-Za-z0-9+/=\s]*)</script>')


class ReplayError(MecpError):
    """A page that is no replay, is damaged, or was made by a later version."""


def write_page(run: dict[str, Any], path: Path) -> None:
    """Write the page that plays a run (`Recorder.run`). Raises `OSError`."""
    packed = base64.b64encode(gzip.compress(json.dumps(run, separators=(",", ":")).encode(), 9, mtime=0)).decode()
    parts = {name: (files(__package__) / name).read_text("utf-8") for name in ("page.html", "style.css", "player.js")}
    page = parts["page.html"].replace("{{title}}", html.escape(run["title"])).replace("{{version}}", str(VERSION))
    for mark, text in (("{{style}}", parts["style.css"]), ("{{player}}", parts["player.js"]), ("{{run}}", packed)):
        page = page.replace(mark, text)
    path.write_text(page, "utf-8")


def read_page(path: Path) -> dict[str, Any]:
    """The run in a page. Raises `ReplayError` for a file that is none, `OSError` for one that cannot be read."""
    found = PACKED.search(path.read_text("utf-8", errors="replace"))
    if found is None:
        raise ReplayError(f"{path}: no replay of mecp_env, or a part of it is missing; {AGAIN}")
    if int(found[1]) > VERSION:
        raise ReplayError(f"{path}: version {found[1]} of the replay, this mecp_env reads up to {VERSION}; update it")
    try:
        run = json.loads(gzip.decompress(base64.b64decode(found[2], validate=True)))
    except (ValueError, OSError, EOFError, zlib.error) as error:
        raise ReplayError(f"{path}: the run in it is damaged ({error}); {AGAIN}") from error
    if not isinstance(run, dict) or not run.get("frames"):
        raise ReplayError(f"{path}: the run in it has no frames")
    return run
