"""Mutated inputs: maps, replay pages, results, runs and keywords, each a sound one that was changed at random.

An input ends in a typed error (`MecpError` or Gymnasium's own), or gives a right result: a map that goes on,
observations in their space. Everything else is a fault: a raw exception, more than 10 s of processor time, more than
1 GB of memory. Every fault is listed with what makes it again. Logs, plans and the fields of maps, which older results
have, are mutated by the tests.
"""

from __future__ import annotations

import json
import re
import signal
import tempfile
import time
import traceback
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from benchmarks import mutated_keywords
from benchmarks.common import Figures, Options, in_parallel
from benchmarks.mutated_keywords import mapped
from benchmarks.tables import listed, whole_rows
from mecp_env.cli.demo import recipe_of
from mecp_env.config import EnvConfig
from mecp_env.core.errors import MecpError
from mecp_env.policies.suites import FORMAT, METRICS, SUITES, VERSION, checksum_of, leaderboard, read_submission
from mecp_env.render.replay_page import read_page, write_page
from mecp_env.slam import SlamPipeline
from tests.floorplans.mutations import spoilt_bytes, spoilt_json
from tests.slam.drives import fed

PER_KIND, QUICK = 92, 2
MOST_S, MOST_MB, HANGS_S = 10.0, 1000.0, 60
SEED = 39_005
TYPED = MecpError, gym.error.Error
STATUS, FORGET_PEAK = Path("/proc/self/status"), Path("/proc/self/clear_refs")
Rng = np.random.Generator


class FileKind(NamedTuple):
    """Files of a kind."""

    name: str
    sound: Callable[[Path], Any]  # writes one
    spoil: Callable[[bytes, Rng], bytes]  # a mutated copy
    use: Callable[[Path], Any]  # reads it, and checks what it gives


def use_map(path: Path) -> None:
    """Go on in a map, and write it again."""
    pipeline = SlamPipeline.from_map(path)
    *_, output = fed(pipeline, mapped()[0], 3, 7)
    assert output.diverged or np.isfinite(output.belief.T_map_robot).all()
    pipeline.save_map(path)


def result() -> str:
    """A result of a suite, of one episode."""
    name, suite = next(iter(SUITES.items()))
    setting = suite.settings[0]
    figures = {metric: {"value": 0.5, "low": 0.4, "high": 0.6} for metric in METRICS}
    row = {"task": setting.task or setting.difficulty, "policy": "mine", "estimator": "slam", "figures": figures}
    row |= {"episodes": [{"building": 0} | dict.fromkeys(METRICS, 0.5)]}
    content: dict[str, Any] = {"format": FORMAT, "version": VERSION, "suite": name, "hash": suite.frozen}
    content |= {"command": "x", "commit": "", "hours": None, "seeds": None, "results": [row]}
    return json.dumps(content | {"checksum": checksum_of(content)})


def other_result(data: bytes, rng: Rng) -> bytes:
    """A result with other values, and in most cases the checksum of these."""
    text = spoilt_json(data, rng)
    content = json.loads(text)
    if not isinstance(content, dict) or rng.random() < 0.2:
        return text
    content.pop("checksum", None)
    with suppress(ValueError, UnicodeEncodeError):
        return json.dumps(content | {"checksum": checksum_of(content)}).encode()
    return text


def use_result(path: Path) -> None:
    """Read a result, and print a table of it."""
    assert leaderboard({path.name: read_submission(path)}).startswith("|")


RECIPE = {"seed": 3, "policy": "breadth_first", "config": EnvConfig(max_steps=3).to_dict()}
RUN = {"title": "a", "frames": [{"step": k, "pose": [k, 2, 3]} for k in range(2)]}
FILES: dict[str, FileKind] = {
    "map bytes": FileKind("map.zip", lambda path: mapped()[1].save_map(path), spoilt_bytes, use_map),
    "replay page": FileKind(
        "a.html", lambda path: write_page(RUN, path), spoilt_bytes, lambda path: write_page(read_page(path), path)
    ),
    "result": FileKind("a.json", lambda path: path.write_text(result()), other_result, use_result),
    "run": FileKind(
        "config.json",
        lambda path: path.write_text(json.dumps(RECIPE)),
        spoilt_json,
        lambda path: EnvConfig.build(recipe_of(path.parent)["config"]),
    ),
}
KINDS = (*FILES, *mutated_keywords.CALLS)


def run(options: Options) -> Figures:
    """How inputs of each kind end, what the worst took, and the faults."""
    units = [(kind, number) for kind in KINDS for number in range(QUICK if options.quick else PER_KIND)]
    ends = in_parallel(end_of, dict[str, Any], units, options)
    pairs = list(zip(units, ends, strict=True))
    rows = {kind: summary([end for unit, end in pairs if unit[0] == kind]) for kind in KINDS}
    faulty = [text for unit, end in pairs if (text := fault_of(unit, end))]
    return {"kinds": rows, "all": summary(ends), "faults": dict(enumerate(faulty))}


def summary(ends: list[dict[str, Any]]) -> Figures:
    """The figures of some inputs."""
    counts = Counter(end["end"] for end in ends)
    worst = {"slowest_s": max(end["seconds"] for end in ends), "largest_mb": max(end["mb"] for end in ends)}
    return {"inputs": len(ends), **{name: counts[name] for name in ("typed", "right", "raw")}, "timed": worst}


def fault_of(unit: tuple[str, int], end: dict[str, Any]) -> str:
    """What is wrong with an input, empty when nothing is."""
    if end["end"] == "raw":
        return f"{unit}: {end['said']}"
    over = end["seconds"] > MOST_S or end["mb"] > MOST_MB
    return f"{unit}: {end['seconds']:.0f} s, {end['mb']:.0f} MB: {end['said']}" if over else ""


def end_of(unit: tuple[str, int]) -> dict[str, Any]:
    """How an input of a kind ends, with its cost."""
    kind, number = unit
    rng = np.random.default_rng([SEED, zlib.crc32(kind.encode()), number])
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(action="ignore"):
        mapped()
        what, call = prepared(kind, Path(folder), rng)
        with suppress(OSError):
            FORGET_PEAK.write_text("5")
        before, start = memory_mb("VmRSS"), time.process_time()
        with limit():
            end, said = outcome(call)
    said = re.sub(r"0x[0-9a-f]+", "0x", f"{said} {what}".replace(folder, ""))
    return {"end": end, "said": said, "seconds": time.process_time() - start, "mb": memory_mb("VmHWM") - before}


def prepared(kind: str, folder: Path, rng: Rng) -> tuple[str, Callable[[], Any]]:
    """A mutated input of a kind in words, and what uses it."""
    if kind in mutated_keywords.CALLS:
        return mutated_keywords.CALLS[kind](rng)
    file = FILES[kind]
    path = folder / file.name
    path.write_bytes(file.spoil(sound_bytes(kind), rng))
    return "", lambda: file.use(path)


@cache
def sound_bytes(kind: str) -> bytes:
    """A sound file of a kind, made once in a process."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / FILES[kind].name
        FILES[kind].sound(path)
        return path.read_bytes()


def outcome(call: Callable[[], Any]) -> tuple[str, str]:
    """How a call ends, and what it says."""
    try:
        call()
    except TYPED as error:
        return "typed", str(error)[:200]
    except Exception as error:  # any other error is a finding
        where = traceback.extract_tb(error.__traceback__)[-1]
        said = f"{type(error).__name__}: {error!s:.200} at {Path(where.filename).name}:{where.lineno}"
        return "raw", " ".join(said.split())
    return "right", ""


@contextmanager
def limit() -> Iterator[None]:
    """Within it, what hangs ends in a `TimeoutError`."""

    def hangs(*_: object) -> None:
        raise TimeoutError(f"more than {HANGS_S} s")

    before = signal.signal(signal.SIGALRM, hangs)
    signal.alarm(HANGS_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def memory_mb(field: str) -> float:
    """Memory in use (`VmRSS`), or its peak since that was reset (`VmHWM`); 0 where the system does not say it."""
    if not STATUS.exists():
        return 0.0
    return int(STATUS.read_text().partition(f"{field}:")[2].split()[0]) / 1024


def faults(figures: Figures) -> list[str]:
    """The faults."""
    return list(figures["faults"].values())


def report(figures: Figures) -> str:
    """The counts by kind, and every fault."""
    rows = {
        name: {key: row[key] for key in ("inputs", "typed", "right", "raw")} | row["timed"]
        for name, row in (figures["kinds"] | {"all": figures["all"]}).items()
    }
    head = ["kind", "inputs", "typed errors", "right results", "faults", "slowest, s", "most memory, MB"]
    return f"{whole_rows(head, rows)}\n\n{listed(faults(figures), 'No faults.')}"
