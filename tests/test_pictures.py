"""The pictures of docs/one-scan.md are those that the command on the page draws."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mecp_env.cli import main as cli
from tests.command_lines import ROOT

PAGE = (ROOT / "docs/one-scan.md").read_text()
SHOWN = re.findall(r"!\[[^]]+\]\((images/one-scan/[^)]+)\)", PAGE)
MOST_CHANGED = 0.005  # share of the pixels: fonts differ between machines, and the last bits of a number


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The pictures that the command draws now."""
    folder = tmp_path_factory.mktemp("one-scan")
    line = re.search(r"^mecp-env (one-scan .*) --out docs/images/one-scan$", PAGE, re.MULTILINE)
    assert line is not None
    assert cli.main([*shlex.split(line[1]), "--out", str(folder)]) == 0
    return folder


def pixels(path: Path) -> np.ndarray:
    """(height, width) grey levels."""
    return np.asarray(Image.open(path).convert("L"), dtype=float)


def changed(first: np.ndarray, second: np.ndarray) -> float:
    """The share of the pixels that clearly differ."""
    return float((np.abs(first - second) > 64.0).mean())


def test_the_page_shows_every_picture_and_no_other(drawn: Path) -> None:
    names = {path.name for path in drawn.iterdir()}
    assert names == {Path(path).name for path in SHOWN}
    assert names == {path.name for path in (ROOT / "docs/images/one-scan").iterdir()}


@pytest.mark.parametrize("path", SHOWN)
def test_a_picture_is_that_of_the_present_code(path: str, drawn: Path) -> None:
    kept, now = pixels(ROOT / "docs" / path), pixels(drawn / Path(path).name)
    assert kept.shape == now.shape
    assert changed(kept, now) < MOST_CHANGED
    assert changed(kept, np.full_like(kept, 255.0)) > 2 * MOST_CHANGED  # the measure sees what is drawn
