"""A page in a real browser."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from benchmarks.browser import Browser, chromium

DRAWN = "Number(document.body?.dataset.drawn) > 0"
needs_browser = pytest.mark.skipif(chromium() is None, reason="no Chromium on this machine")


@contextmanager
def shown(page: Path, fragment: str = "", width: int = 1280) -> Iterator[Browser]:
    """A browser that has drawn a replay."""
    with Browser(width) as browser:
        browser.show(page, fragment)
        browser.wait(DRAWN)
        yield browser
