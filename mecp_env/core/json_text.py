"""JSON of files that a user received: what its values take in memory is known before they are made."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

PIECE = 2**20
TEXT = re.compile(rb'"(?:[^"\\]++|\\.)*+"?')
# Bytes that each part takes at most in CPython: a place in a list with its growth, a list with its first places, an
# object with one field, each field, a number that is not among the small ones, and a text without its letters.
PLACE, LIST, OBJECT, FIELD, NUMBER, LETTERS = 9, 104, 200, 60, 32, 80
WIDE = 4  # bytes per letter of a text with escaped letters; other texts of ASCII have one
ANY, PER_BYTE = 40 * 2**20, 15  # what may be made of any file, and of each of its bytes


def read_json(path: Path, most: int, hook: Callable[[Any], Any] | None = None) -> Any:
    """The value in a JSON file of at most `most` bytes. Raises `ValueError` for another content, and `OSError`."""
    size = path.stat().st_size
    if size > most:
        raise ValueError(f"{size} bytes, at most {most}")
    with path.open("rb") as file:
        return loads(file.read(size), ANY + PER_BYTE * size, hook)


def loads(data: bytes, most: float, hook: Callable[[Any], Any] | None = None) -> Any:
    """The value of a JSON text in UTF-8. Raises `ValueError` where it is none, or takes more than `most` bytes."""
    if memory_of(data) > most:
        raise ValueError(f"its values take more than {most / 2**20:.0f} MiB, too much for its size")
    try:
        return json.loads(data.decode(), object_pairs_hook=hook)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def memory_of(data: bytes) -> int:
    """Bytes that the values of a JSON text take, at most."""
    wide = WIDE if b"\\u" in data or not data.isascii() else 1
    letters = sum(LETTERS + wide * len(found[0]) for found in TEXT.finditer(data))
    parts = PLACE * data.count(b",") + LIST * data.count(b"[") + OBJECT * data.count(b"{") + FIELD * data.count(b":")
    pieces = (np.frombuffer(data, np.uint8, min(PIECE, len(data) - at), at) for at in range(0, len(data), PIECE))
    return letters + parts + NUMBER * sum(map(_numbers, pieces))


def _numbers(piece: Any) -> int:
    """How many words of a piece are no small whole numbers, all of which Python makes once."""
    ends = np.flatnonzero(~_IN_NUMBER[piece])
    starts, ends = np.concatenate([[0], ends + 1]), np.append(ends, len(piece))
    long, three = ends - starts > 3, starts[ends - starts == 3]
    below_200 = (piece[three] == ord("1")) & _DIGIT[piece[three + 1]] & _DIGIT[piece[three + 2]]
    negative = np.count_nonzero(piece == ord("-"))
    return int(np.count_nonzero(long) + len(three) - np.count_nonzero(below_200) + negative)


_DIGIT = np.isin(np.arange(256), list(b"0123456789"))
_IN_NUMBER = np.isin(np.arange(256), list(b"0123456789+-.eE"))
