"""The rows of a table as cells, whatever separates them, and the numbers, missing values and dates in the cells."""

from __future__ import annotations

import codecs
import io
import math
import re
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from functools import partial
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Array

LONGEST_LINE = 2**20
COMMENTS = ("#", "%")
SEPARATORS = (";", "\t", "|", ",")
LIST, JOIN = re.compile(r"[\[({]([^\[\](){}]*)[\])}]"), "\x1f"
ARRAY = re.compile(r"array\('\w', (\[[^\[\]]*+\])\)")  # as Python prints a list of a ROS 2 message
FEWEST_LISTED = 8  # numbers in a cell with spaces between them that are a list without brackets
COMPACT_DATE = re.compile(r"((?:19|20)\d{6})[-_ T](\d{6})((?:[.,]\d+)?(?:Z|[-+]\d\d:?\d\d)?)\Z")
PAIR = re.compile(r"(?<![A-Za-z])([A-Za-z]++)\s*+[:=]\s*+([^\s,;]++)")  # a name with its value, as `theta: 12.5`
MISSING = {"", "-", "--", "?", "na", "n/a", "#n/a", "<na>", "null", "nil", "none", "nat", "missing"}
NOT_FINITE = ("1.#inf", "-1.#inf", "1.#qnan", "-1.#ind")  # as old C libraries of Windows write them


class Row(NamedTuple):
    """A line of a table."""

    number: int  # from 1
    cells: list[str]
    names: tuple[str, ...] = ()  # of the cells, where each has its own before it


def rows_of(data: bytes, comments: bool = False) -> Iterator[Row]:
    """The rows, with comments (without their mark) where they are asked for; empty lines are left out.

    Where no comma separates cells, one in a number is its decimal point. A list in brackets is one cell, with `JOIN`
    in it.
    """
    data = data.removeprefix(codecs.BOM_UTF8)
    data = data if b"\n" in data else data.replace(b"\r", b"\n")
    for number, line in enumerate(iter(partial(io.BytesIO(data).readline, LONGEST_LINE), b""), start=1):
        text = line.decode("utf-8", "replace").replace('"', "").strip(" \r\n")
        if text.startswith(COMMENTS) and not comments:
            continue
        text = text.lstrip("#% ")
        if text:
            yield _row(number, text)


def _row(number: int, text: str) -> Row:
    """The cells of a line."""
    pairs = PAIR.findall(text)
    if len(pairs) > 1:
        names, values = zip(*pairs, strict=True)
        return Row(number, list(values), names)
    text = LIST.sub(_joined, ARRAY.sub(r"\1", text))
    separator = next((mark for mark in SEPARATORS if mark in text), None)
    text = text if separator in (",", None) else text.replace(",", ".")
    cells = text.removesuffix(separator or "").split(separator)
    return Row(number, cells if separator is None else [_listed(cell) for cell in cells])


def _listed(cell: str) -> str:
    """A cell, with `JOIN` between the numbers of a list that has no brackets."""
    words = cell.split() if cell.count(" ") >= FEWEST_LISTED - 1 else ()
    return JOIN.join(words) if len(words) >= FEWEST_LISTED and numbers(words) is not None else cell


def _joined(found: re.Match[str]) -> str:
    """The numbers of a list as one cell; the unit of a name, as in `x[m]`, behind it."""
    words = re.split(r"[\s,;|]+", found[1].strip(" \t,;|"))
    return f"_{words[0]}" if len(words) == 1 and numbers(words) is None else JOIN.join(words)


def flat(cells: Sequence[str]) -> list[str]:
    """The words of all cells: those of a list one by one."""
    return [word for cell in cells for word in cell.split(JOIN)]


def one_each(names: list[str], cells: list[str]) -> list[str]:
    """A name for each word of a row: those of a list are numbered."""
    if len(names) != len(cells):
        return names
    pairs = zip(names, cells, strict=True)
    return [f"{name}{k}" if JOIN in cell else name for name, cell in pairs for k in range(cell.count(JOIN) + 1)]


def number(word: str) -> float:
    """A number; nan where a word says that there is none. Raises `ValueError`."""
    if not word:
        return math.nan
    try:
        if "_" in word:  # in Python, one may be within a number
            raise ValueError
        return float(word)
    except ValueError:
        if word.strip().lower() in MISSING or word.strip().lower().startswith(NOT_FINITE):
            return math.nan
        raise


def numbers(words: Sequence[str]) -> Array | None:
    """(k,) the numbers of words; None where one is none."""
    try:
        return np.fromiter(map(number, words), np.float64, len(words))
    except ValueError:
        return None


def seconds(word: str, unit_s: float) -> float:
    """s of a stamp: a number of some unit, a date (UTC unless it names a zone), or a time of the day.

    Raises `ValueError`.
    """
    compact = COMPACT_DATE.match(word.strip())
    if compact is not None:
        return _since_1970(f"{compact[1]}T{compact[2]}{compact[3]}")
    try:
        return unit_s * number(word)
    except ValueError:
        date = word.strip().replace("/", "-")
        return _since_1970(date if "-" in date else f"1970-01-01T{date}")


def _since_1970(date: str) -> float:
    """s of a date in a form of ISO 8601. Raises `ValueError`."""
    moment = datetime.fromisoformat(date)
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
