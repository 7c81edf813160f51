"""Mutated inputs: logs, plans, maps, results and keywords, each a sound one that was changed at random.

An input ends in a typed error (`MecpError` or Gymnasium's own), or gives a right result: a log with a finite path, a
plan that can be built and read again, a map that goes on, observations in their space. Everything else is a fault: a
raw exception, more than 10 s of processor time, more than 1 GB of memory. Every fault is listed with what makes it
again. Sound files and mutations are those of the tests, with seeds of their own.
"""

from __future__ import annotations

import re
import signal
import tempfile
import time
import traceback
import warnings
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks import mutated_files, mutated_keywords
from benchmarks.common import Figures, Options, in_parallel
from benchmarks.tables import one_table
from mecp_env.core.errors import MecpError

PER_KIND, QUICK = 92, 2  # 2,024 in all
MOST_S, MOST_MB, HANGS_S = 10.0, 1000.0, 60
SEED = 39_005
KINDS = (*mutated_files.KINDS, *mutated_keywords.CALLS)
TYPED = MecpError, gym.error.Error
STATUS, FORGET_PEAK = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def run(options: Options) -> Figures:
    """How inputs of each kind end, what the worst took, and the faults."""
    units = [(kind, number) for kind in KINDS for number in range(QUICK if options.quick else PER_KIND)]
    ends = in_parallel(end_of, dict[str, Any], units, options)
    rows = {kind: summary([end for unit, end in zip(units, ends, strict=True) if unit[0] == kind]) for kind in KINDS}
    faulty = [text for unit, end in zip(units, ends, strict=True) if (text := fault_of(unit, end))]
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
        call = prepared(kind, Path(folder), rng)
        with suppress(OSError):
            FORGET_PEAK.write_text("5")
        before, start = memory_mb("VmRSS"), time.process_time()
        with limit():
            end, said = outcome(call, folder)
    return {"end": end, "said": said, "seconds": time.process_time() - start, "mb": memory_mb("VmHWM") - before}


def prepared(kind: str, folder: Path, rng: np.random.Generator) -> Any:
    """What uses a mutated input of a kind."""
    if kind in mutated_keywords.CALLS:
        mutated_files.mapped()
        return lambda: mutated_keywords.CALLS[kind](rng)
    found, path = mutated_files.KINDS[kind], mutated_files.sound_file(kind)
    for beside in path.parent.iterdir():
        if beside.is_file():
            (folder / beside.name).write_bytes(beside.read_bytes())
    (folder / path.name).write_bytes(found.spoil(path, rng))
    return lambda: found.use(folder / path.name)


def outcome(call: Any, folder: str) -> tuple[str, str]:
    """How a call ends, and what it says."""
    try:
        return "right", str(call() or "")
    except TYPED as error:
        return "typed", str(error)[:200].replace(folder, "")
    except Exception as error:  # any other error is a finding
        where = traceback.extract_tb(error.__traceback__)[-1]
        notes = " ".join(getattr(error, "__notes__", []))
        said = f"{type(error).__name__}: {error!s:.200} at {Path(where.filename).name}:{where.lineno} {notes}"
        return "raw", re.sub(r"0x[0-9a-f]+", "0x", " ".join(said.replace(folder, "").split()))


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
    """Memory in use (`VmRSS`), or its peak since that was reset (`VmHWM`)."""
    if not STATUS.exists():
        return 0.0  # not measured on this system
    return int(STATUS.read_text().partition(f"{field}:")[2].split()[0]) / 1024


def faults(figures: Figures) -> list[str]:
    """The faults."""
    return list(figures["faults"].values())


def report(figures: Figures) -> str:
    """The counts by kind, and the cost of the worst."""
    rows = figures["kinds"] | {"all": figures["all"]}
    counts = {name: {key: row[key] for key in row if key != "timed"} | row["timed"] for name, row in rows.items()}
    return one_table(counts)
