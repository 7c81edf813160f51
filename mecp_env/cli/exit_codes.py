"""How a command ends: its exit code, and one line on stderr instead of a traceback for an error of the user.

Standard output of a run that continues when its reader has closed the pipe (`mecp-env train ... | head -1`).
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from typing import Any, TypeVar

import gymnasium as gym

from mecp_env.core.errors import MecpError
from mecp_env.core.files import sanitised
from mecp_env.core.interrupts import INTERRUPTED as INTERRUPTED
from mecp_env.core.interrupts import leave, was_interrupted


class UnbreakableStream:
    """A stream that reports a closed pipe once on stderr, and then discards all output."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """As of the stream."""
        self._attempt(lambda: self._stream.write(text))
        return len(text)

    def flush(self) -> None:
        """As of the stream."""
        self._attempt(self._stream.flush)

    def _attempt(self, operation: Callable[[], object]) -> None:
        try:
            operation()
        except BrokenPipeError:
            with suppress(OSError):  # stderr may be the same closed pipe
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())  # also for what is in its buffer
                print_error("the output pipe is closed; the run continues without output")


@contextmanager
def unbreakable_output() -> Iterator[None]:
    """Within it standard output raises no `BrokenPipeError`."""
    with redirect_stdout(UnbreakableStream(sys.stdout)):
        yield


FAILED, WRONG_INPUT = 1, 2  # beside 0 and INTERRUPTED
T = TypeVar("T")


def run_command(command: Callable[[], int]) -> int:
    """The exit code of `command`; 2 for wrong input or a file that cannot be read or written, 130 after Ctrl-C.

    It is 0 when the reader of the output closed the pipe, as in `mecp-env explore nearest | head -1`.
    """
    try:
        return command()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
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


def exit_code(code: int, saved: bool) -> int:
    """The exit code of a run that ended with `code`; 1 where the run is well but its map was not `saved`."""
    return code or (0 if saved else FAILED)


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


def tracked(items: Iterable[T], total: int, what: str) -> Iterable[T]:
    """The items one by one, with a bar on stderr where that is a terminal."""
    from rich.console import Console  # the overview of all commands does without
    from rich.progress import track

    console = Console(stderr=True)
    return track(items, what, total, console=console, transient=True, disable=not console.is_terminal)
