"""Figures of few pixels or none, for tests of what else a command does: to compute pixels is most of its time."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from mecp_env.cli import runs

DRAFT_DPI = 60


@pytest.fixture(scope="module")
def draft_figures() -> Iterator[None]:
    """Every figure has at most `DRAFT_DPI` dots per inch."""
    savefig = Figure.savefig

    def save(figure: Figure, *where: Any, dpi: float = DRAFT_DPI, **more: Any) -> None:
        savefig(figure, *where, dpi=min(dpi, DRAFT_DPI), **more)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", save)
        yield


@pytest.fixture
def blank_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are files without content, and films short."""
    monkeypatch.setattr(runs, "FRAMES", 2)
    monkeypatch.setattr(runs, "save", lambda figure, path, **_: Path(path).touch())
