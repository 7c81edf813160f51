"""The page of a replay: player, style and the packed run in one HTML file that needs no network.

What changed from one frame to the next: a map that stays as it is takes no room in the page.
"""

from __future__ import annotations

import base64
import gzip
import html
import io
import json
import re
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, Self

import numpy as np

from mecp_env.core.carriers import Array, Bytes
from mecp_env.core.errors import MecpError
from mecp_env.core.files import loads, write_atomic

Row = list[int]  # x, y, xx, xy, yy of a landmark
ENOUGH = 0.1  # share by which a covariance must change to be written again


def changed_rows(frames: Iterable[dict[int, Row]]) -> Iterator[list[Row]]:
    """For each frame the rows [id, x, y, xx, xy, yy] that are new or changed, and [id] of what is gone."""
    written: dict[int, Row] = {}
    for rows in frames:
        gone = [[name] for name in written if name not in rows]
        news = {name: row for name, row in rows.items() if _differs(written.get(name), row)}
        written = {name: row for name, row in written.items() if name in rows} | news
        yield gone + [[name, *row] for name, row in news.items()]


def _differs(old: Row | None, new: Row) -> bool:
    if old is None or old[:2] != new[:2]:
        return True
    spread = max(old[2] + old[4], 1)
    return max(abs(a - b) for a, b in zip(old[2:], new[2:], strict=True)) > ENOUGH * spread


@dataclass(frozen=True, slots=True, eq=False)
class PackedGrid:
    """The cells of a grid, packed: a run has hundreds of large ones."""

    packed: bytes
    shape: tuple[int, ...]  # H, W
    place: Array  # (2,) m: the lower left corner

    @classmethod
    def of(cls, codes: Bytes, place: Array) -> Self:
        """That with the codes (H,W) of its cells."""
        return cls(zlib.compress(codes.tobytes(), 1), codes.shape, place)

    @property
    def codes(self) -> Bytes:
        """(H,W) those of its cells."""
        return np.frombuffer(zlib.decompress(self.packed), np.uint8).reshape(self.shape)


def changed_cells(grids: Sequence[PackedGrid], cell_m: float) -> tuple[Array, list[int], list[Row]]:
    """The lower left corner (2,) m of all grids together, their width and height in cells, and the changes.

    `grids`: that of each frame, the same object while nothing changed. The
    changes of a frame are runs of cells: the first one, counted row by row, how many, their code; and so on.
    """
    low = np.min([grid.place for grid in grids], axis=0)
    high = np.max([grid.place + cell_m * np.array(grid.shape[::-1]) for grid in grids], axis=0)
    width, height = np.round((high - low) / cell_m).astype(int).tolist()
    shown, changes, last = np.zeros((height, width), np.uint8), list[Row](), None
    for grid in grids:
        changes.append([] if grid is last else _runs(shown, _laid(grid, low, cell_m, (height, width))))
        last = grid
    return low, [width, height], changes


def _laid(grid: PackedGrid, low: Array, cell_m: float, shape: tuple[int, int]) -> Bytes:
    column, row = np.round((grid.place - low) / cell_m).astype(int).tolist()
    whole = np.zeros(shape, np.uint8)
    whole[row : row + grid.shape[0], column : column + grid.shape[1]] = grid.codes
    return whole


def _runs(shown: Bytes, now: Bytes) -> Row:
    """Runs of the cells that differ, which are then `shown`."""
    differ = np.flatnonzero(shown != now)
    codes = now.ravel()[differ]
    begins = np.flatnonzero((np.diff(differ, prepend=-2) > 1) | (np.diff(codes.astype(int), prepend=-1) != 0))
    lengths = np.diff(np.append(begins, len(differ)))
    shown[:] = now
    return np.column_stack([differ[begins], lengths, codes[begins]]).ravel().tolist()


VERSION = 1
AGAIN = "run the command that made it again"
MARK = re.compile(r"\{\{(\w+)\}\}")
# What is made of a run, for any one and per byte of it as it is packed; of honest ones 5.4 bytes of text, 56 of values.
JSON_BYTES, VALUE_BYTES = (2**23, 8), (2**25, 62)
MOST_BYTES = 2**29  # of a page
PACKED = re.compile(rb'<script id="run" type="text/plain" data-version="(\d{1,9})">([A-Za-z0-9+/=\s]*)</script>')


class ReplayError(MecpError):
    """A page that is no replay, is damaged, or was made by a later version."""


def write_page(run: dict[str, Any], path: Path) -> None:
    """Write the page that plays a run (`Recorder.run`, `read_page`). Raises `OSError`."""
    packed = gzip.compress(json.dumps(run, separators=(",", ":")).encode(), 9, mtime=0)
    player = files(__package__) / "player"
    parts = {name: (player / name).read_text("utf-8") for name in ("page.html", "style.css", "player.js")}
    texts = {"title": html.escape(run["title"]), "version": str(VERSION), "run": base64.b64encode(packed).decode()}
    texts |= {"style": parts["style.css"], "player": parts["player.js"]}
    page = MARK.sub(lambda mark: texts[mark[1]], parts["page.html"])  # at once: a text may hold what looks like a mark
    write_atomic(path, page.encode("utf-8", "replace"))


def read_page(path: Path) -> dict[str, Any]:
    """The run in a page. Raises `ReplayError` for a file that is none, `OSError` for one that cannot be read."""
    packed = packed_run(path)
    try:
        run = loads(unpacked(packed), VALUE_BYTES[0] + VALUE_BYTES[1] * len(packed))
    except (ValueError, OSError, EOFError, zlib.error, MemoryError) as error:
        raise ReplayError(f"{path}: the run in it is damaged ({error!s:.200}); {AGAIN}") from error
    if not isinstance(run, dict) or not isinstance(run.get("frames"), list) or not run["frames"]:
        raise ReplayError(f"{path}: the run in it has no frames")
    if not isinstance(run.get("title"), str):
        raise ReplayError(f"{path}: title: {type(run.get('title')).__name__}, expected a text; {AGAIN}")
    return run


def packed_run(path: Path) -> bytes:
    """The run in a page, as it is packed. Raises `ReplayError` and `OSError`."""
    if path.exists() and not path.is_file():
        raise ReplayError(f"{path}: a folder, or no plain file; {AGAIN}")
    if path.stat().st_size > MOST_BYTES:
        raise ReplayError(f"{path}: {path.stat().st_size} bytes, at most {MOST_BYTES}")
    found = PACKED.search(path.read_bytes())
    if found is None:
        raise ReplayError(f"{path}: no replay of mecp_env, or a part of it is missing; {AGAIN}")
    if int(found[1]) > VERSION:
        made = found[1].decode()  # of nine digits at most
        raise ReplayError(f"{path}: version {made} of the replay, this mecp_env reads up to {VERSION}; update it")
    try:
        return base64.b64decode(found[2], validate=True)
    except ValueError as error:
        raise ReplayError(f"{path}: the run in it is damaged ({error!s:.200}); {AGAIN}") from error


def unpacked(packed: bytes) -> bytes:
    """The JSON of a run. Raises `ValueError` where it would take far more memory than any run of its size."""
    most = int(JSON_BYTES[0] + JSON_BYTES[1] * len(packed))
    with gzip.open(io.BytesIO(packed)) as file:
        text = file.read(most + 1)
    if len(text) > most:
        raise ValueError(f"{len(packed)} bytes that make more than {most} bytes of text")
    return text
