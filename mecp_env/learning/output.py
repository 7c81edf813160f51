"""Standard output of a run that continues when its reader has closed the pipe (`... | head -1`)."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from typing import Any

ALONE = "train: nobody reads the output any more; the run goes on without"


class Enduring:
    """A stream that says once on stderr that its reader has gone, and then takes everything."""

    def __init__(self, stream: Any) -> None:
        self._stream, self._alone = stream, False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """As of the stream."""
        self._try(self._stream.write, text)
        return len(text)

    def flush(self) -> None:
        """As of the stream."""
        self._try(self._stream.flush)

    def _try(self, do: Any, *arguments: Any) -> None:
        try:
            do(*arguments)
        except BrokenPipeError:
            self._go_on_alone()

    def _go_on_alone(self) -> None:
        with suppress(OSError, ValueError):  # what stands in the stream's memory has to go somewhere
            os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())
        if not self._alone:
            self._alone = True
            with suppress(OSError):  # the reader of both has gone
                print(ALONE, file=sys.stderr, flush=True)


@contextmanager
def enduring_output() -> Iterator[None]:
    """Within it standard output raises no `BrokenPipeError`."""
    with redirect_stdout(Enduring(sys.stdout)):  # type: ignore[type-var]
        yield
