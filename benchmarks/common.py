"""Shared by all benchmarks: intervals, the calibration workload, parallel runs, result files and the gate.

A benchmark is a module with `run(options) -> dict`: nested dicts of figures, a figure being a number or an `estimate`.
It may have `report(figures) -> str`, tables in Markdown, where `tables.report_of` does not make them from the names of
the figures; `figure(figures)`, a figure of matplotlib that is saved as PNG beside them; `pictures(options)`, figures by
name that are saved as PNG and SVG in a folder beside them; and `faults(figures) -> list[str]`, what exceeds its bound.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
import os
import platform
import re
import sys
import time
import timeit
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.tables import flatten, readable, report_of
from mecp_env.cli.base import tracked
from mecp_env.core.carriers import Array
from mecp_env.core.errors import ConfigError
from mecp_env.core.intervals import Figures, correlation, estimate, ratio, share
from mecp_env.core.jit import compiled
from mecp_env.core.provenance import checksums, dependencies
from mecp_env.core.work_units import WHOLE, FailedUnit, KeptResults, Shard, run_kept

__all__ = ["Figures", "correlation", "estimate", "ratio", "share"]  # of mecp_env.core.intervals

RESULTS = Path(__file__).parent / "results"
MOST = 400  # runs of a set: the split `test` has so many buildings from the first one of each benchmark on
TIME, RATE = re.compile(r"(\b|_)(us|ms|s)\b"), re.compile("per_s|per second")  # in the path of a figure
UNITS = Path("runs/benchmarks")  # results of units of work, until all of a benchmark are there


@dataclass(frozen=True, slots=True)
class Options:
    """Options of a benchmark from the command line."""

    jobs: int = 1  # parallel processes
    quick: bool = False  # a small sample with rough results
    sets: Sequence[str] = ()  # a subset, for benchmarks with sets
    against: str | None = None  # a git commit to compare the working tree with
    shard: Shard = WHOLE  # of the units of work, for benchmarks with units
    folder: Path = UNITS  # of the results of units
    records: Path | None = None  # folder of the drives that are replayed; None: they are driven again each time
    cluster: str = ""  # the address of a Ray cluster that the units run on
    task: str = ""  # of active SLAM
    policies: Sequence[str] = ()
    buildings: int = 0  # at each point; 0: as many as the benchmark has by itself


class ShardDone(Exception):
    """A part of the units is finished, which gives no figures yet."""


class OptionError(ConfigError):
    """An option on the command line that the benchmark does not support."""


def chosen(
    options: Options, there_are: Mapping[str, int], quick: Mapping[str, int] | None = None, most: int = MOST
) -> Mapping[str, int]:
    """Number of runs of each set named on the command line as `NAME` or `NAME:COUNT`, or of all; with --quick, `quick`.

    Raises `OptionError` for an unknown name or an invalid count.
    """
    counts = {}
    for given in options.sets:
        name, _, count = given.partition(":")
        if name not in there_are:
            raise OptionError(f"--sets {given}: expected one of {', '.join(there_are)}, got {name!r}")
        if count and not (count.isdecimal() and 1 <= int(count) <= most):
            raise OptionError(f"--sets {given}: expected NAME or NAME:COUNT, a count from 1 to {most}")
        counts[name] = int(count or there_are[name])
    return counts or (quick if quick and options.quick else there_are)


def runs_of(options: Options, counts: Mapping[str, int], quick: int = 2) -> list[tuple[str, int]]:
    """Set and number of each run: of the sets on the command line or all; with --quick, the first `quick` of each."""
    most = quick if options.quick else MOST
    return [(name, number) for name, count in chosen(options, counts).items() for number in range(min(count, most))]


def shared_data(kind: str) -> Path | None:
    """The folder `shared/data/KIND` beside the repository, None elsewhere."""
    folders = (parent / "shared" / "data" / kind for parent in Path(__file__).resolve().parents)
    return next((folder for folder in folders if folder.is_dir()), None)


def in_parallel(
    task: Callable[[Any], Any], kind: Any, units: Sequence[tuple[Any, ...]] | Mapping[str, Any], options: Options
) -> list[Any]:
    """The result of `task`, of the type `kind`, for each unit in order.

    Units are tuples of words and numbers, or have names. Results are kept in `options.folder`, so that the same command
    continues after a kill. Raises `ShardDone` after a part of the units, and the error of a unit that failed after all
    others are finished.
    """
    kept = KeptResults(options.folder, kind, run_key(options))
    all_units = units if isinstance(units, Mapping) else {" ".join(map(str, unit)): unit for unit in units}
    named = dict(options.shard.part(list(all_units.items())))
    results, errors = dict[str, Any](), list[Exception]()
    finished = run_kept(task, named, kept, options.jobs, options.cluster)
    for name, result in tracked(finished, len(named), "units"):
        results[name] = result
        if isinstance(result, FailedUnit):
            errors.append(result.error)
            print(f"failed: {result}", file=sys.stderr)
    if errors:
        raise errors[0]
    if options.shard != WHOLE:
        raise ShardDone(f"{len(named)} units of shard {options.shard} are in {options.folder}")
    return [results[name] for name in named]


def run_key(options: Options) -> dict[str, Any]:
    """What results belong to: only those of one key are combined."""
    own = options.records is None or options.records.parent == options.folder  # made for this run
    records = "" if own else str(options.records)
    return {"--records": records, **checksums(), **dependencies(Path(__file__).parent)}


def grouped(units: Sequence[tuple[Any, ...]], results: Sequence[Any]) -> dict[Any, list[Any]]:
    """The results by their units without the last word, the number; a single word stands for itself."""
    groups: dict[Any, list[Any]] = {}
    for (*key, _), result in zip(units, results, strict=True):
        groups.setdefault(key[0] if len(key) == 1 else tuple(key), []).append(result)
    return groups


def in_turns(calls: Mapping[Any, Callable[[], Any]], rounds: int) -> list[dict[Any, Any]]:
    """The results of all calls by name in each round, in which another one is first each time."""
    names = list(calls)
    turns = (names[k % len(names) :] + names[: k % len(names)] for k in range(rounds))
    return [{name: calls[name]() for name in turn} for turn in turns]


def in_rounds(calls: Mapping[Any, Callable[[], Any]], rounds: int) -> dict[Any, Array]:
    """(rounds,...) what each call measures, in turns; a round before, which loads compiled functions, is left out."""
    turns = in_turns(calls, rounds + 1)[1:]
    return {name: np.array([turn[name] for turn in turns]) for name in calls}


def steps_per_s(step: Callable[[], int], seconds: float) -> float:
    """Control steps per second of calls that return their number, over at least this time."""
    start, steps = time.perf_counter(), 0
    while time.perf_counter() < start + seconds:
        steps += step()
    return steps / (time.perf_counter() - start)


def best_of(call: Callable[[], object], calls: int = 7) -> float:
    """Seconds of one call of `call`: the least of some, after one to warm up."""
    call()
    return min(timeit.repeat(call, repeat=calls, number=1))


def is_installed(package: str) -> bool:
    """Whether a package of an extra is there."""
    return importlib.util.find_spec(package) is not None


def from_lab(package: str, what: str) -> Any:
    """A package of the extra `lab`. Raises `OptionError` that says what needs it where it is not installed."""
    try:
        return importlib.import_module(package)
    except ModuleNotFoundError:
        raise OptionError(f"{what}: pip install -e '.[lab]'") from None


@compiled
def _calibration(n: int) -> float:
    """A fixed workload like that of the compiled functions: trigonometry, divisions, branches, a small array."""
    table = np.zeros(512)
    x = 0.3
    for i in range(n):
        x = math.sin(x + i) * 1.7 + table[i % 512] / (1.0 + x * x)
        table[(i * 7) % 512] = x if x > 0.0 else -0.5 * x
    return x


def calibration_ms() -> float:
    """Milliseconds of the calibration workload on this machine now; times are compared as ratios to it."""
    return 1e3 * best_of(lambda: _calibration(200_000))


def machine() -> dict[str, str]:
    """The machine and versions of a measurement."""
    cpuinfo = Path("/proc/cpuinfo")
    model = re.search(r"model name\s*: (.*)", cpuinfo.read_text()) if cpuinfo.is_file() else None
    versions = dependencies()
    return {
        "processor": model[1].strip() if model else platform.processor() or "unknown",
        "cores": str(os.cpu_count()),
        "system": versions["machine"],
        **{name: versions[name] for name in ("python", "numba", "numpy")},
    }


def page_of(content: Figures, module: Any, picture: str = "") -> str:
    """The page of a result: its origin, what the benchmark measures, its report or all figures, its faults."""
    faults = module.faults(content["figures"]) if hasattr(module, "faults") else None
    machine = ", ".join(f"{name} {value}" for name, value in content["machine"].items())
    workload = f"calibration workload {content['calibration_ms']:.2f} ms"
    parts = [
        f"# Benchmark: {content['benchmark']}",
        f"{content['date']}, `{content['command']}`; {machine}; {workload}.",
        (module.__doc__ or "").strip(),
        getattr(module, "report", report_of)(content["figures"]),
        "" if faults is None else "\n".join(f"- {fault}" for fault in faults) or "No faults.",
        f"![{content['benchmark']}]({picture})" if picture and hasattr(module, "figure") else "",
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def differences(now: Figures, baseline: Figures) -> list[str]:
    """Where `now` differs from `baseline`, a line each: intervals that do not meet, numbers more than 2 % apart.

    Times and speeds may differ by 30 % of their ratio to the calibration workload; a missing figure is a difference.
    """
    measured, before = flatten(now["figures"]), flatten(baseline["figures"])
    slower = now["calibration_ms"] / baseline["calibration_ms"]  # is this machine than that of the baseline
    return [
        f"{path}: {readable(measured.get(path, 'missing'))}, baseline {readable(figure)}"
        for path, figure in before.items()
        if _ends(figure) and _differs(_ends(measured.get(path)), _ends(figure), path, slower)
    ]


def _differs(found: Sequence[float], expected: Sequence[float], path: str, slower: float) -> bool:
    if not found:
        return True
    rate, time = RATE.search(path), TIME.search(path)
    scale, slack = 1.0 / slower if rate else slower if time else 1.0, 1.3 if rate or time else 1.02
    ends = [scale * end * by for end in expected for by in (slack, 1.0 / slack)]
    return found[1] < min(ends) or found[0] > max(ends)


def _ends(figure: Any) -> Sequence[float]:
    """Both ends of an estimate, or a number twice; nothing of a text or of what was not measured."""
    ends = [figure["low"], figure["high"]] if isinstance(figure, dict) else [figure, figure]
    return ends if all(isinstance(end, int | float) and math.isfinite(end) for end in ends) else ()
