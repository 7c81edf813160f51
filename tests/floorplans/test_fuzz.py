"""Every kind of real file, mutated by bytes and by structure: a layout or one clear LayoutError, within the limits."""

import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from mecp_env.core.errors import LayoutError
from mecp_env.floorplans import load_plan
from mecp_env.world.layout import load_layout
from mecp_env.world.schema import Layout
from tests.effort import Cost, cost
from tests.floorplans import mutations
from tests.floorplans.untrusted import MEGABYTES, SECONDS
from tests.launcher import Launcher

pytestmark = pytest.mark.filterwarnings("ignore::mecp_env.core.errors.PlanWarning")

KINDS = ("layout", "houseexpo", "map_server", "map_image", "dungeon")
MADE = ("made_house", "made_sheet", "pgm", "png", "labelled")
ROOT = Path(__file__).parents[2]
QUICK, MANY = 30, 37
LETTERS = 800  # eight faults


def spoilt_files(kind: str, seeds: range, folder: Path) -> Iterator[Path]:
    """A file of a kind, mutated by the seed, with the files next to it."""
    made = folder / "made"
    made.mkdir()
    files = (mutations.sources() | mutations.made(made)).get(kind, [])
    for seed in seeds if files else ():
        source = files[seed % len(files)]
        place = folder / str(seed)
        shutil.copytree(source.parent, place, ignore=shutil.ignore_patterns("*.json", "*.py"))
        path = place / source.name
        path.write_bytes(mutations.spoilt(source, np.random.default_rng([seed, (*KINDS, *MADE).index(kind)])))
        yield path
        shutil.rmtree(place)


def tried(path: Path, kind: str) -> Cost:
    """The cost of reading a file or refusing it properly."""
    read = partial(load_plan, path, resolution_m=0.05, kind="labelled" if kind == "labelled" else None)
    found = list[Layout | LayoutError]()
    taken = cost(partial(_note, read, found), SECONDS)
    if isinstance(found[0], Layout):
        assert load_layout(json.loads(found[0].to_json())) == found[0]
    else:
        refused = str(found[0])
        assert refused.startswith(f"{path}: ")
        assert len(refused) < LETTERS + len(str(path))
    return taken


def _note(read: Callable[[], Layout], found: list[Layout | LayoutError]) -> None:
    try:
        found.append(read())
    except LayoutError as error:
        found.append(error)


@pytest.mark.parametrize("kind", MADE)
def test_spoilt_files_raise_nothing_but_layout_errors(kind: str, tmp_path: Path) -> None:
    assert max(tried(path, kind).seconds for path in spoilt_files(kind, range(QUICK), tmp_path)) < 10.0 * SECONDS


def main(kind: str) -> None:
    """Spoil files of a kind; print how many there were, the most seconds and the most megabytes one took."""
    with tempfile.TemporaryDirectory() as folder:
        load_plan(mutations.made(Path(folder))["made_sheet"][0])
        taken = [tried(path, kind) for path in spoilt_files(kind, range(QUICK, QUICK + MANY), Path(folder))]
    most = [max((getattr(each, name) for each in taken), default=0.0) for name in ("seconds", "megabytes")]
    print(len(taken), *most)


@pytest.fixture(scope="module")
def launcher() -> Iterator[Launcher]:
    """Of processes that have imported this file."""
    with Launcher("tests.floorplans.test_fuzz", path=ROOT) as launcher:
        yield launcher


@pytest.mark.slow
@pytest.mark.parametrize("kind", [*KINDS, *MADE])
def test_many_spoilt_files_cost_less_than_two_seconds_and_200_megabytes(kind: str, launcher: Launcher) -> None:
    """In a separate process that measures the memory of these files only."""
    call = f"from tests.floorplans.test_fuzz import main; main({kind!r})"
    run = launcher.run(call, cwd=ROOT, env=dict(os.environ))
    assert run.returncode == 0, run.stderr[-2000:]
    count, seconds, megabytes = (float(value) for value in run.stdout.split())
    if not count:
        pytest.skip("shared/data/plans is not beside the repository")
    assert count == MANY
    assert (seconds < SECONDS, megabytes < MEGABYTES) == (True, True), run.stdout
