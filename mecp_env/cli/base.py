"""The base class of the commands of `mecp-env`, the types of their options, and checks of the paths they write to.

How a command ends: its exit code, and one line on stderr instead of a traceback for an error of the user.
"""

from __future__ import annotations

import contextlib
import inspect
import io
import os
import sys
import tempfile
import textwrap
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, TypeVar

import gymnasium as gym
from pydantic import AfterValidator, Field

from mecp_env.core.errors import ConfigError, MecpError
from mecp_env.core.files import sanitised
from mecp_env.core.interrupts import INTERRUPTED as INTERRUPTED
from mecp_env.core.interrupts import leave, was_interrupted
from mecp_env.core.settings import guess

ELSEWHERE = "choose another place"
FILE_SUFFIXES = (".json", ".yaml", ".yml", ".svg", ".png", ".gif", ".pgm", ".csv", ".md", ".zip")


LISTS = (  # options that take several words; those of `tyro.conf.UseAppendAction` take one, and may be given again
    *("--env.reward.custom", "--config.reward.custom", "--buildings.difficulty", "--buildings.spec"),
    *("--shapes", "--pieces"),
)


class Line(tuple[str, ...]):
    """The words behind a command as a user types them, and which options they name."""

    @cached_property
    def parts(self) -> list[list[str]]:
        """The words before all options, and then each option with the words up to the next one."""
        parts = [list[str]()]
        for word in self:
            if word.startswith("--"):
                parts.append([])
            parts[-1].append(word)
        return parts

    @cached_property
    def options(self) -> list[tuple[str, list[str]]]:
        """Each option with the words behind it: `("--with", ["a"])` for `--with a` and for `--with=a`."""
        split = ((part[0].partition("="), part[1:]) for part in self.parts[1:])
        return [(name, [value, *rest] if equals else rest) for (name, equals, value), rest in split]

    def named(self, prefix: str = "--") -> list[str]:
        """The options that start with a prefix, each once, as fields: `laser.max_range_m` below `--config.`."""
        names = dict.fromkeys(name for name, _ in self.options if name.startswith(prefix))
        return [name.removeprefix(prefix).replace("-", "_") for name in names]

    @property
    def sections(self) -> set[str]:
        """The options, each without what follows a dot: `{"env", "max_steps"}`."""
        return {name.partition(".")[0] for name in self.named()}

    def first_words(self, option: str) -> list[str]:
        """The first word behind an option, each time that the line has it: `["a", "b"]` for `--with a --with=b`."""
        return [words[0] for name, words in self.options if name == option and words]

    def gathered(self, lists: Collection[str] = LISTS) -> Line:
        """The line with all words of an option of `lists` behind its first place, where the parser reads them."""
        found, parts = dict[str, list[str]](), [self.parts[0]]
        for part, (name, words) in zip(self.parts[1:], self.options, strict=True):
            if name in found:
                found[name] += words
            elif name in lists:
                found[name] = [name, *words]
                parts.append(found[name])
            else:
                parts.append(part)
        return Line(word for part in parts for word in part)


class Command(ABC):
    """A command: a dataclass of its options. Types may have bounds, as `Seed` has.

    The docstring is its help: a paragraph, and below it examples of lines that a user may type.
    """

    fixes: ClassVar[Mapping[str, Sequence[str]]] = {}  # option -> those that have no meaning beside it
    needs: ClassVar[Mapping[str, Sequence[str]]] = {}  # option -> those of which one gives it a meaning

    @classmethod
    def help(cls) -> tuple[str, list[str]]:
        """What the command does, and its examples."""
        about, _, examples = inspect.cleandoc(cls.__doc__ or "").partition("\n\nExamples:\n")
        return about, textwrap.dedent(examples).splitlines()

    @classmethod
    def completed(cls, line: Line) -> Line:
        """The line with what a user may leave out."""
        return line

    @classmethod
    def defaults(cls, line: Line) -> Self | None:
        """What the options are where the line does not say; None: as the dataclass has it."""
        return None

    def check(self, line: Line) -> None:
        """Refuse options that another one fixes, or that mean nothing without another one. Raises `ConfigError`."""
        given = line.sections
        for option, others in self.fixes.items():
            for other in [other for other in others if {option, other} <= given]:
                raise ConfigError(f"{self._said(other)}: {self._said(option)} fixes it; leave out one of the two")
        for option, others in self.needs.items():
            if option in given and given.isdisjoint(others):
                name, those = option.replace("_", "-"), " or ".join(f"--{other}" for other in others)
                raise ConfigError(f"--{name}: has a meaning with {those} only; name one")

    def _said(self, name: str) -> str:
        """An option as it was given: `--task ActiveHalls-v0`."""
        value = getattr(self, name)
        shown = isinstance(value, str | int | Path) and not isinstance(value, bool)
        return f"--{name.replace('_', '-')}{f' {value}' if shown else ''}"

    @abstractmethod
    def run(self, line: Line) -> int:
        """Do the work; `line` is what the options were read from. Returns the exit code; raises `MecpError`."""


def check_word(name: str, word: str, known: Iterable[str]) -> str:
    """The word itself. Raises `ConfigError` for one that is not one of the known ones, with a suggestion."""
    if word not in (names := list(known)):
        raise ConfigError(f"{name}: {word!r:.80}, expected one of {', '.join(names)}{guess(word, names)}")
    return word


def one_of(name: str, known: Iterable[str]) -> AfterValidator:
    """The check of an option that is one of some words, or empty."""
    return AfterValidator(lambda word: word and check_word(name, word, known))


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


def check_json(path: Path, option: str) -> Path:
    """`path` itself, a JSON file that may have to be made. Raises `ConfigError`, as `check_writable`."""
    if check_writable(path, f"--{option}").suffix != ".json":
        raise ConfigError(f"{option}: {path}: expected the name of a file that ends in .json")
    return path


Seed = Annotated[int, Field(ge=0)]
Steps = Annotated[int, Field(ge=1, le=10_000_000)]
OutFolder = Annotated[Path, AfterValidator(lambda path: check_folder(path))]


class UnbreakableStream:
    """A stream that discards all output once its reader has closed the pipe."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """As of the stream."""
        self._attempt(self._stream.write, text)
        return len(text)

    def flush(self) -> None:
        """As of the stream."""
        self._attempt(self._stream.flush)

    def _attempt(self, operation: Callable[..., object], *arguments: str) -> None:
        try:
            operation(*arguments)
        except BrokenPipeError:  # to nowhere, also what is in its buffer
            os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())


@contextmanager
def unbreakable_output() -> Iterator[None]:
    """Within it a command goes on, and keeps its files, when the reader of its output is gone (`demo | head -1`)."""
    out, said = UnbreakableStream(sys.stdout), UnbreakableStream(sys.stderr)
    with redirect_stdout(out), redirect_stderr(said):
        try:
            yield
        finally:
            out.flush()
            said.flush()


FAILED, WRONG_INPUT = 1, 2  # beside 0 and INTERRUPTED
T = TypeVar("T")


def run_command(command: Callable[[], int]) -> int:
    """The exit code of `command`; 2 for wrong input or a file that cannot be read or written, 130 after Ctrl-C."""
    try:
        with unbreakable_output():
            return command()
    except (MecpError, gym.error.Error) as error:
        print_error(error)
        return WRONG_INPUT
    except OSError as error:
        print_os_error(error)
        return WRONG_INPUT
    except KeyboardInterrupt:
        print_error("interrupted")
        return INTERRUPTED


def replace_unprintable() -> None:
    """From now on, characters that a terminal's encoding lacks are printed as `?`."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            with contextlib.suppress(OSError):  # a file that was closed, or a pipe without a reader
                stream.reconfigure(errors="replace")


def at_end(code: int) -> int:
    """The exit code of the process of a command that ended with `code`; 130 where an interrupt was lost on its way."""
    leave()
    return code or (INTERRUPTED if was_interrupted() else 0)


def as_note(text: str) -> str:
    """A line that says something of a log; a warning is one already."""
    return text if text.startswith("warning: ") else f"note: {text}"


def echo(*lines: object) -> None:
    """Print lines that may contain names from untrusted files, without control characters."""
    for line in lines:
        print(sanitised(str(line)))


def print_error(what: object) -> None:
    """Print one line on stderr, without control characters."""
    print(f"mecp-env: {sanitised(str(what))}", file=sys.stderr)


def print_os_error(error: OSError) -> None:
    """Print which file failed, and why, on stderr."""
    print_error(f"{error.filename or 'output'}: {error.strerror}")


def tracked(items: Iterable[T], total: int, what: str) -> Iterator[T]:
    """The items one by one, with a bar on stderr; without a terminal, a line at every tenth of the way."""
    from mecp_env.render.progress import Bar  # the overview of all commands does without

    with Bar(total, stays=False, stderr=True) as bar:
        for done, item in enumerate(items, start=1):
            yield item
            bar.show(done, what, f"mecp-env: {done} of {total} {what}")
