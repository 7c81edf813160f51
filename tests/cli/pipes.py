"""Output whose reader has gone."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout


@contextmanager
def closed_pipe() -> Iterator[None]:
    """As in `mecp-env demo 2>&1 | true`. (As a fixture it would be undone by the capture of pytest.)"""
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w", buffering=1) as output, redirect_stdout(output), redirect_stderr(output):
        yield
