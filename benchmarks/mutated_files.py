"""Files of the benchmark `mutated`: sound ones of each kind, a mutated copy of one, and what reads it.

The sound files and the mutations are those of the tests, the seeds are other ones.
"""

from __future__ import annotations

import base64
import gzip
import io
import json
import random
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.common import RESULTS
from mecp_env.cli.demo import recipe_of
from mecp_env.config import EnvConfig
from mecp_env.evaluation.log_run import LogRunConfig, run_log
from mecp_env.evaluation.trajectory import tum
from mecp_env.floorplans import load_plan
from mecp_env.floorplans.exporters import save_svg
from mecp_env.logs import read_log
from mecp_env.policies.suites import checksum_of, leaderboard, read_submission
from mecp_env.render.replay_page import read_page, write_page
from mecp_env.slam import SlamMap, SlamPipeline
from mecp_env.world.layout import load_layout
from mecp_env.world.outline import build_outline
from tests.env.test_state_fuzz import PARTS, mutate, nodes, other_kind, other_shape, other_values
from tests.floorplans import plans
from tests.floorplans.mutations import spoilt, spoilt_bytes, spoilt_json
from tests.logs import test_fuzz
from tests.logs.files import BEARINGS, CARMEN, drive, write_archive, write_bag, write_carmen
from tests.slam.drives import Drive, fed, scripted_drive

Rng = np.random.Generator
RESULT = RESULTS / "suites" / "quick_nearest.json"
FIRST, SCANS = 3, 4  # scans of a drive after a map was read


@dataclass(frozen=True, slots=True)
class Kind:
    """Inputs of a kind."""

    sound: Callable[[Path], Path]  # writes a file into a folder
    spoil: Callable[[Path, Rng], bytes]  # the bytes of a mutated copy
    use: Callable[[Path], None]  # reads a file, and checks what it gives


@cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory()


@cache
def sound_file(name: str) -> Path:
    """The sound file of a kind, made once in a process."""
    folder = Path(_folder().name) / name
    folder.mkdir()
    return KINDS[name].sound(folder)


def text_or_bytes(path: Path, rng: Rng) -> bytes:
    """A log with other lines, words or bytes."""
    ways = test_fuzz.TEXT if path.suffix in (".log", ".csv", ".dat", ".tum") else test_fuzz.BYTES
    return ways[int(rng.integers(len(ways)))](path.read_bytes(), random.Random(int(rng.integers(2**32))))


def other_bytes(path: Path, rng: Rng) -> bytes:
    """Other bytes of any file."""
    return spoilt_bytes(path.read_bytes(), rng)


def other_arrays(path: Path, rng: Rng) -> bytes:
    """An archive of which an array has other numbers, another type or shape; sometimes other bytes."""
    if rng.random() < 0.2:
        return text_or_bytes(path, rng)
    arrays = dict(np.load(path))
    name, change = str(rng.choice(list(arrays))), (other_values, other_shape, other_kind)[int(rng.integers(3))]
    file = io.BytesIO()
    np.savez(file, **arrays | {name: change(arrays[name], rng)})
    return file.getvalue()


def use_log(path: Path) -> None:
    """Read a log, and map its first scans."""
    log = read_log(path)
    assert len(log) >= 1
    assert (np.diff(log.t) > 0.0).all()
    run = run_log(log, run=LogRunConfig(scans=20))
    assert np.isfinite(run.T_map_robot).all()
    json.dumps(run.metrics())


def text_file(name: str, text: Callable[[], str]) -> Callable[[Path], Path]:
    """What writes a file with a text into a folder."""

    def write(folder: Path) -> Path:
        (folder / name).write_text(text())
        return folder / name

    return write


def write_csv(folder: Path) -> Path:
    """The drive as a table."""
    head = ",".join(["t,x,y,heading", *(f"{angle:.4f}" for angle in np.degrees(BEARINGS))])
    np.savetxt(folder / "a.csv", np.column_stack(drive()), "%.4f", ",", header=head, comments="")
    return folder / "a.csv"


def dat() -> str:
    """The drive as BreezySLAM has it."""
    t, _, ranges = drive()
    rows = [
        " ".join(map(str, [round(1e6 * s), k, 40 * k, 41 * k, *[0] * 20, *(1e3 * row).astype(int), 0]))
        for k, (s, row) in enumerate(zip(t, ranges, strict=True))
    ]
    return "\n".join([*rows, ""])


def use_plan(path: Path) -> None:
    """Read a plan, and build it; what is written is read again."""
    with warnings.catch_warnings(action="ignore"):
        layout = load_plan(path, resolution_m=0.05 if path.suffix in (".png", ".pgm") else None)
    build_outline(layout)
    assert load_layout(json.loads(layout.to_json())) == layout


@cache
def mapped() -> tuple[Drive, SlamPipeline]:
    """A short drive, and the estimator after it."""
    short, pipeline = scripted_drive(), SlamPipeline()
    list(fed(pipeline, short, 0, 30))
    return short, pipeline


def write_map(folder: Path) -> Path:
    """The map after a drive."""
    mapped()[1].save_map(folder / "map.zip")
    return folder / "map.zip"


def other_fields(path: Path, rng: Rng) -> bytes:
    """A map of which a field has another value."""
    state = SlamMap.load(path).state
    mutate(dict.fromkeys(PARTS, state), nodes(dict.fromkeys(PARTS, state)), rng)
    SlamMap(state).save(path.with_name("other.zip"))
    return path.with_name("other.zip").read_bytes()


def use_map(path: Path) -> None:
    """Go on in a map, and write it again."""
    pipeline = SlamPipeline.from_map(path)
    *_, output = fed(pipeline, mapped()[0], FIRST, FIRST + SCANS)
    assert output.diverged or np.isfinite(output.belief.T_map_robot).all()
    pipeline.save_map(path.with_name("again.zip"))


def write_replay(folder: Path) -> Path:
    """A page of two frames; what the player reads is not needed here."""
    write_page({"title": "a", "frames": [{"step": k, "pose": [k, 2, 3]} for k in range(2)]}, folder / "a.html")
    return folder / "a.html"


def other_page(path: Path, rng: Rng) -> bytes:
    """A page with other bytes, or with another run in it."""
    if rng.random() < 0.5:
        return spoilt_bytes(path.read_bytes(), rng)
    run = read_page(path)
    text = spoilt_json(json.dumps(run).encode(), rng)
    return path.read_bytes().replace(_packed(json.dumps(run, separators=(",", ":")).encode()), _packed(text))


def _packed(text: bytes) -> bytes:
    return base64.b64encode(gzip.compress(text, 9, mtime=0))


def use_page(path: Path) -> None:
    """Read a page, and write it again."""
    write_page(read_page(path), path.with_name("again.html"))


def other_result(path: Path, rng: Rng) -> bytes:
    """A result with other values, and in most cases the checksum of these."""
    text = spoilt_json(path.read_bytes(), rng)
    content = json.loads(text)
    if not isinstance(content, dict) or rng.random() < 0.2:
        return text
    content.pop("checksum", None)
    try:
        return json.dumps(content | {"checksum": checksum_of(content)}).encode()
    except (ValueError, UnicodeEncodeError):
        return text


def use_result(path: Path) -> None:
    """Read a result, and print a table of it."""
    assert leaderboard({path.name: read_submission(path)}).startswith("|")


def recipe() -> str:
    """The configuration of a run of `demo`."""
    return json.dumps({"seed": 3, "policy": "breadth_first", "config": EnvConfig(max_steps=3).to_dict()})


def use_recipe(path: Path) -> None:
    """Read it as `replay` does."""
    EnvConfig.build(recipe_of(path.parent)["config"])


KINDS: dict[str, Kind] = {
    "log npz": Kind(lambda folder: write_archive(folder / "a.npz"), other_arrays, use_log),
    **{
        f"log {line}": Kind(
            lambda folder, line=line: write_carmen(folder / "a.log", CARMEN[line]), text_or_bytes, use_log
        )
        for line in ("flaser", "robotlaser", "rawlaser")
    },
    "log csv": Kind(write_csv, text_or_bytes, use_log),
    "log dat": Kind(text_file("a.dat", dat), text_or_bytes, use_log),
    "log tum": Kind(text_file("a.tum", lambda: tum(*drive()[:2])), text_or_bytes, use_log),
    "log bag": Kind(lambda folder: write_bag(folder / "a.bag"), text_or_bytes, use_log),
    "log mcap": Kind(lambda folder: write_bag(folder / "a.mcap"), text_or_bytes, use_log),
    "plan layout": Kind(text_file("a.json", lambda: load_layout("furnished").to_json()), spoilt, use_plan),
    "plan house": Kind(text_file("house.json", lambda: json.dumps(plans.house())), spoilt, use_plan),
    "plan yaml": Kind(lambda folder: plans.map_pair(folder, plans.two_rooms_picture()), spoilt, use_plan),
    "plan png": Kind(lambda folder: plans.save(plans.corridor_picture(), folder / "a.png"), spoilt, use_plan),
    "plan svg": Kind(lambda folder: save_svg(load_layout("two_rooms"), folder / "a.svg"), other_bytes, use_plan),
    "map bytes": Kind(write_map, other_bytes, use_map),
    "map fields": Kind(write_map, other_fields, use_map),
    "replay page": Kind(write_replay, other_page, use_page),
    "result": Kind(text_file("a.json", RESULT.read_text), other_result, use_result),
    "run": Kind(text_file("config.json", recipe), spoilt, use_recipe),
}
