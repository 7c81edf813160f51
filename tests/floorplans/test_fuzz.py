"""Every kind of file, mutated by bytes and by structure: a layout or one clear LayoutError, within the limits."""

import json
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from mecp_env.core.errors import LayoutError
from mecp_env.floorplans import load_plan
from mecp_env.world.layout import load_layout
from tests.floorplans import mutations
from tests.floorplans.plans import SECONDS

pytestmark = pytest.mark.filterwarnings("ignore::mecp_env.core.errors.PlanWarning")

KINDS = ("layout", "house", "sheet", "pgm", "png", "labelled")
FILES = 30
LETTERS = 800  # eight faults


def spoilt_files(kind: str, seeds: range, folder: Path) -> Iterator[Path]:
    """A file of a kind, mutated by the seed, with the files next to it."""
    made = folder / "made"
    made.mkdir()
    files = mutations.made(made)[kind]
    for seed in seeds:
        source = files[seed % len(files)]
        place = folder / str(seed)
        shutil.copytree(source.parent, place, ignore=shutil.ignore_patterns("*.json", "*.py"))
        path = place / source.name
        path.write_bytes(mutations.spoilt(source, np.random.default_rng([seed, KINDS.index(kind)])))
        yield path
        shutil.rmtree(place)


def read(path: Path, kind: str) -> str:
    """Read a file; the refusal of one that is refused properly."""
    try:
        layout = load_plan(path, resolution_m=0.05, kind="labelled" if kind == "labelled" else None)
    except LayoutError as error:
        return str(error)
    assert load_layout(json.loads(layout.to_json())) == layout
    return f"{path}: sound"


@pytest.mark.parametrize("kind", KINDS)
def test_spoilt_files_raise_nothing_but_layout_errors(kind: str, tmp_path: Path) -> None:
    """What they cost in memory, `test_plan_files.py` bounds."""
    for path in spoilt_files(kind, range(FILES), tmp_path):
        start = time.process_time()
        said = read(path, kind)
        assert said.startswith(f"{path}: ")
        assert len(said) < LETTERS + len(str(path))
        assert time.process_time() - start < 3.0 * SECONDS
