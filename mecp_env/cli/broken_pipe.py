"""Standard output of a run that continues when its reader has closed the pipe (`mecp-env train ... | head -1`)."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from typing import Any

from mecp_env.cli.exit_codes import print_error


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
