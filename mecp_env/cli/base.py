"""The base class of the commands of `mecp-env`, and checks of the paths that they write to."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from typing import ClassVar, Self

from mecp_env.core.errors import ConfigError
from mecp_env.core.settings import guess

FILE_SUFFIXES = (".json", ".yaml", ".yml", ".svg", ".png", ".gif", ".pgm", ".csv", ".md", ".zip")


class Command(ABC):
    """A command: a dataclass of its options, whose docstring is its help."""

    examples: ClassVar[tuple[str, ...]] = ()  # lines that a user may type, shown by --help

    choices: ClassVar[Mapping[str, Sequence[str]]] = {}  # option -> the words that it takes

    @classmethod
    def completed(cls, line: Sequence[str]) -> list[str]:
        """The line with what a user may leave out."""
        return list(line)

    @classmethod
    def hints(cls, line: Sequence[str]) -> list[str]:
        """What was probably meant by words that an option does not take."""
        pairs = [pair for pair in pairwise(line) if pair[1] not in cls.choices.get(pair[0], (pair[1],))]
        near = [(option, word, guess(word, cls.choices[option])) for option, word in pairs]
        return [f"{option} {word}{found}" for option, word, found in near if found]

    @classmethod
    def defaults(cls, line: Sequence[str]) -> Self | None:
        """What the options are where the line does not say; None: as the dataclass has it."""
        return None

    @abstractmethod
    def run(self, line: Sequence[str]) -> int:
        """Do the work; `line` is what the options were read from. Returns the exit code; raises `MecpError`."""


def check_writable(path: Path) -> Path:
    """`path` itself, of which nothing is made yet. Raises `ConfigError` where it could not be made, or written to.

    A folder that would have to be made with the name of a file, as in `paper.json/x.json`, is a mistake.
    """
    missing = [folder for folder in path.absolute().parents if not folder.exists()]
    for folder in (folder for folder in missing if folder.suffix.lower() in FILE_SUFFIXES):
        raise ConfigError(f"out: {path}: {folder.name} is the name of a file, not of a folder; choose another place")
    there = next((place for place in (path.absolute(), *path.absolute().parents) if place.exists()), Path())
    if there != path.absolute() and not there.is_dir():
        raise ConfigError(f"out: {path}: {there} is a file, not a folder; choose another place")
    if not os.access(there, os.W_OK):
        raise ConfigError(f"out: {path}: {there} cannot be written to; choose another place")
    return path


def check_folder(path: Path) -> Path:
    """`path` itself, a folder that may have to be made. Raises `ConfigError` for a file, and as `check_writable`."""
    if path.exists() and not path.is_dir():
        raise ConfigError(f"out: {path} is a file, a folder is expected; choose another place")
    check_writable(path / "file")
    return path


@contextmanager
def folder_of(path: Path) -> Iterator[None]:
    """Make the folder that a file goes into; where writing fails, what was made of it and is empty goes again."""
    above = path.absolute().parents
    made = [folder for folder in above if not folder.exists()]
    above[0].mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        for folder in made:
            _remove_empty(folder)
        raise


def _remove_empty(folder: Path) -> None:
    with suppress(OSError):  # something is in it
        folder.rmdir()
