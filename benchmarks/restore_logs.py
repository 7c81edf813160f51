"""Recorded logs of the benchmark `restore`: the map after a part of a log comes back to the bit, and goes on alike."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import shared_data
from mecp_env.core.snapshot import encode
from mecp_env.evaluation.log_run import LogRunConfig, config_for, run_log
from mecp_env.logs import Log, read_log
from mecp_env.slam import SlamPipeline

MOST, MORE = 60, 4  # scans before the map is kept, and after
log_of = lru_cache(2)(read_log)  # the runs of a process share a log
NAMES = (
    *("fr079.npz", "intel_raw.npz", "csail_raw.npz"),
    *("orebro-corrected.log.gz", "edmonton-corrected.log.gz", "freiburg-101-corrected.log.gz"),
)


def logs_at_hand() -> list[Path]:
    """The logs of buildings in `shared/data/logs` beside the repository, none elsewhere."""
    folder = shared_data("logs")
    return [path for name in NAMES if folder is not None and (path := folder / name).is_file()]


def failure_of(number: int, rng: np.random.Generator, slam: dict[str, Any]) -> str:
    """What is wrong with a run on a log, empty when nothing is."""
    path = logs_at_hand()[int(rng.integers(len(logs_at_hand())))]
    steps, lost = int(rng.integers(1, MOST)), bool(rng.random() < 0.2)
    return described(
        f"{number}: {path.name} {slam} after {steps} scans{', lost' * lost}",
        lambda: fault_of(log_of(path), rng, slam, steps, lost),
    )


def described(what: str, fault_of: Callable[[], str]) -> str:
    """What was run and what is wrong with it, empty when nothing is; an error of any kind is a finding, too."""
    try:
        fault = fault_of()
    except Exception as error:
        fault = f"{type(error).__name__}: {error}"
    return f"{what}: {fault}" if fault else ""


def fault_of(log: Log, rng: np.random.Generator, slam: dict[str, Any], steps: int, lost: bool) -> str:
    """What differs between the estimator after a part of a log and the one of its saved map, now or further on."""
    part = LogRunConfig(odometry=str(rng.choice(sources(log))), first=int(rng.integers(len(log) - 2 * MOST)))
    pipeline = run_log(log, config_for(log, slam), part.model_copy(update={"scans": steps})).pipeline
    if lost:
        pipeline.lose_pose()
    other, fault = restored(pipeline)
    if fault:
        return fault
    rest = part.model_copy(update={"first": part.first + steps, "scans": MORE})
    for each in (pipeline, other):
        run_log(log, run=rest, pipeline=each)
    return "" if same(encode(pipeline), encode(other)) else "another state after it"


def sources(log: Log) -> list[str]:
    """What the odometry of a log can be made of."""
    there = {"log": log.T_odom_robot is not None, "reference": log.T_ref_robot is not None}
    return [name for name, is_there in there.items() if is_there]


def restored(owner: Any) -> tuple[SlamPipeline, str]:
    """The estimator of the map that an environment or estimator saves, and what differs when it is saved again."""
    with tempfile.TemporaryDirectory() as folder:
        first, second = Path(folder) / "map.zip", Path(folder) / "again.zip"
        owner.save_map(first)
        other = SlamPipeline.from_map(first)
        other.save_map(second)
        return other, "" if first.read_bytes() == second.read_bytes() else "another map"


def same(first: Any, second: Any) -> bool:
    """True when all values are equal to the bit, nan too."""
    if isinstance(first, np.ndarray):
        return first.dtype == second.dtype and first.shape == second.shape and first.tobytes() == second.tobytes()
    if isinstance(first, dict):
        return first.keys() == second.keys() and all(same(first[key], second[key]) for key in first)
    if isinstance(first, list | tuple):
        return len(first) == len(second) and all(map(same, first, second))
    return type(first) is type(second) and repr(first) == repr(second)
