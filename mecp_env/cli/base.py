"""The base class of the commands of `mecp-env`, the types of their options, and checks of the paths they write to."""

from __future__ import annotations

import tempfile
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, ClassVar, Self

from pydantic import AfterValidator, Field

from mecp_env.core.errors import ConfigError
from mecp_env.core.settings import guess

ELSEWHERE = "choose another place"
FILE_SUFFIXES = (".json", ".yaml", ".yml", ".svg", ".png", ".gif", ".pgm", ".csv", ".md", ".zip")


LISTS = (  # options that take several words; those of `tyro.conf.UseAppendAction` take one, and may be given again
    *("--env.reward.custom", "--config.reward.custom", "--buildings.difficulty", "--buildings.spec"),
    *("--shapes", "--pieces"),
)


class Command(ABC):
    """A command: a dataclass of its options, whose docstring is its help. Types may have bounds, as `Seed` has."""

    examples: ClassVar[tuple[str, ...]] = ()  # lines that a user may type, shown by --help

    choices: ClassVar[Mapping[str, Sequence[str]]] = {}  # option -> the words that it takes

    @classmethod
    def own_modules(cls, line: Sequence[str]) -> list[str]:
        """Modules of the user to import before options are checked: they register names."""
        return []

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

    def check(self, line: Sequence[str]) -> None:
        """Refuse options that contradict each other, before anything is loaded. Raises `ConfigError`."""
        return

    @property
    def keeps_results(self) -> bool:
        """True when files are the result: the run goes on when the reader of its output is gone (`demo | head`)."""
        return False

    @abstractmethod
    def run(self, line: Sequence[str]) -> int:
        """Do the work; `line` is what the options were read from. Returns the exit code; raises `MecpError`."""


def gathered(line: Sequence[str], options: Collection[str] = LISTS) -> list[str]:
    """The line with all words of an option of `options` behind its first place, where the parser reads them."""
    found, parts = dict[str, list[str]](), [list[str]()]
    part = parts[0]
    for word in line:
        name, _, value = word.partition("=")
        if name in options:
            known = len(found)
            part = found.setdefault(name, [name])
            part += [value] if value else []
            parts += [part] if len(found) > known else []
        elif word.startswith("--"):
            part = [word]
            parts.append(part)
        else:
            part.append(word)
    return [word for part in parts for word in part]


def check_word(name: str, word: str, known: Iterable[str]) -> None:
    """Raise `ConfigError` for a word that is not one of the known ones, with a suggestion."""
    if word not in (names := list(known)):
        raise ConfigError(f"{name}: {word!r:.80}, expected one of {', '.join(names)}{guess(word, names)}")


def check_folder(path: Path, option: str = "--out") -> Path:
    """`path` itself, a folder that may have to be made. Raises `ConfigError` where nothing can be written in it.

    A folder that would have to be made with the name of a file, as in `paper.json/x.json`, is a mistake.
    """
    places = (path.absolute(), *path.absolute().parents)
    there = next(place for place in places if place.exists())
    for folder in places[: places.index(there)]:
        if folder.suffix.lower() in FILE_SUFFIXES:
            raise ConfigError(f"{option}: {path}: {folder.name} is the name of a file, not of a folder; {ELSEWHERE}")
    if not there.is_dir():
        raise ConfigError(f"{option}: {there} is a file, not a folder; {ELSEWHERE}")
    try:
        tempfile.TemporaryFile(dir=there).close()
    except OSError as error:
        raise ConfigError(f"{option}: {there} cannot be written to ({error.strerror}); {ELSEWHERE}") from None
    return path


def check_writable(path: Path, option: str = "--out") -> Path:
    """`path` itself, a file that may have to be made. Raises `ConfigError` where it cannot be written."""
    check_folder(path.parent, option)
    if path.is_dir():
        raise ConfigError(f"{option}: {path} is a folder, not a file; {ELSEWHERE}")
    return path


Seed = Annotated[int, Field(ge=0)]
Steps = Annotated[int, Field(ge=1, le=10_000_000)]
OutFolder = Annotated[Path, AfterValidator(lambda path: check_folder(path))]
