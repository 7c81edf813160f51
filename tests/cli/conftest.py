"""Commands draw their figures in few pixels: to compute these is most of the time of many a command."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from matplotlib.figure import Figure

DRAFT_DPI = 60


@pytest.fixture(scope="package", autouse=True)
def draft_figures() -> Iterator[None]:
    """Figures of few pixels, as many as a test asks for; tests of the pictures themselves are in tests/render."""
    savefig = Figure.savefig

    def save(figure: Figure, *where: Any, dpi: float = DRAFT_DPI, **more: Any) -> None:
        savefig(figure, *where, dpi=min(dpi, DRAFT_DPI), **more)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", save)
        yield
