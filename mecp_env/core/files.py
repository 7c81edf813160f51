"""Files: paths with impossible names (too long, or with a NUL byte), and files written whole or not at all.

JSON of files that a user received: what its values take in memory is known before they are made. Text from such files
(names of buildings, rooms and files) is made harmless before it is shown.
"""

from __future__ import annotations

import codecs
import json
import os
import re
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from mecp_env.core.errors import LayoutError

exists, is_folder = os.path.exists, os.path.isdir  # False, too, for a name that no file can have


def read_bytes(path: Path, most: int) -> bytes:
    """The bytes of a file. Raises LayoutError for one that is missing, no plain file, or larger than `most`."""
    try:
        if not path.is_file():
            raise LayoutError("no such file")
        size = path.stat().st_size
        if size > most:
            raise LayoutError(f"the file has {size} bytes, at most {most}")
        with path.open("rb") as file:
            return file.read(size)  # no more is set aside
    except (OSError, ValueError) as error:  # unreadable; a NUL byte in the name
        raise error if isinstance(error, LayoutError) else LayoutError(f"cannot be read: {error}") from None


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Let an `OSError` name the file that is written, as where a library leaves it out when the disk is full."""
    try:
        yield
    except OSError as error:
        if error.filename is not None or error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


def write_atomic(path: Path, data: bytes) -> None:
    """Write a file so that after a crash at any time the old or the new one exists, never a part.

    What is no plain file, such as a pipe or /dev/stdout, is written to as it is. Raises `OSError` that names it, as
    when the disk is full.
    """
    if path.exists() and not path.is_file():
        with naming(path):
            path.write_bytes(data)
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{uuid.uuid4().hex}.tmp")
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        temporary.unlink(missing_ok=True)
    if os.name == "posix":  # make the name last, too
        handle = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


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
    """The value of a JSON text (`text_of`). Raises `ValueError` where it is none, or takes more than `most` bytes."""
    if memory_of(data) > most:
        raise ValueError(f"its values take more than {most / 2**20:.0f} MiB, too much for its size")
    try:
        return json.loads(text_of(data), object_pairs_hook=hook)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def text_of(data: bytes) -> str:
    """A text in UTF-8, with or without a byte order mark, or in UTF-16 with one, as editors and shells of Windows save.

    Raises `ValueError`.
    """
    return data.decode("utf-16" if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig")


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


def sanitised(words: str) -> str:
    """`words` with a question mark for every character that cannot be printed, such as terminal control codes."""
    return "".join(sign if sign.isprintable() else "?" for sign in words)
