"""Mutated inputs: keywords of `make` and `reset`, actions, and fields of `SlamConfig`, with values of any kind.

An input ends in a typed error (`MecpError` or Gymnasium's own), or gives a right result: observations in their space, a
finite pose. Everything else is a fault: a raw exception, more than 10 s of processor time, more than 1 GB of memory.
Every fault is listed with what makes it again. Files, which older results have, are mutated by the tests.
"""

from __future__ import annotations

import re
import signal
import time
import traceback
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks.common import Figures, Options, in_parallel
from benchmarks.tables import listed, whole_rows
from mecp_env.config import EnvConfig, merge
from mecp_env.core.errors import MecpError
from mecp_env.floorplans.options import PlanOptions
from mecp_env.slam import SlamConfig, SlamPipeline
from mecp_env.world.config import GeneratorSpec
from mecp_env.world.layout import LIBRARY
from tests.floorplans.mutations import VALUES
from tests.slam.drives import Drive, fed, scripted_drive

PER_KIND, QUICK = 92, 2
MOST_S, MOST_MB, HANGS_S = 10.0, 1000.0, 60
SEED = 39_005
TYPED = MecpError, gym.error.Error
STATUS, FORGET_PEAK = Path("/proc/self/status"), Path("/proc/self/clear_refs")
Rng = np.random.Generator
STEPS = 5
ODD: tuple[Any, ...] = (
    *VALUES, b"x", object(), lambda: 0, {1, 2}, np.nan, np.float32(0.3), np.int8(3), np.zeros(3), np.array(2.0), 1j,
    "slam", "goal", "flat", "paper", "two_rooms", (1.0, 2.0, 3.0), (0.5, 0.2), 2, 5, 0.3, 10.0, 100, 2**31, True, "0.1",
    "nan", float("-inf"), np.datetime64("2020-01-01"), range(3), {"preset": "paper"}, {"kind": "ekf"}, {"x": {"y": 1}},
    {1: 2}, "\0", "mecp", [None], type, 1e-300, -0.0,
)  # fmt: skip
FACTORS = (0.0, 0.1, 0.5, 0.9, 1.1, 2.0, 5.0, 50.0, -1.0)
WORDS = (
    "slam", "known", "truth", "goal", "velocity", "discrete", "flat", "image", "dict", "random", "layout", "riekf",
    "ekf", "fej", "mecp", "mecp_paper", "jcbb", "ccda", "nearest", "paper", "urg04lx", "ideal", "skid_steer", "terms",
    "always", "never", "adaptive", "fixed", "sensor", "unknown", "free", "per_step", "linear", "easy", "hard", "test",
)  # fmt: skip
IDS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {  # id -> what it needs, fields beside those of the environment
    **dict.fromkeys(("Layout-v0", "PaperMap-v0"), ({}, {})),
    **{
        name: ({}, GeneratorSpec().model_dump() | {"difficulty": "", "split": ""})
        for name in ("First-v0", "ActiveHalls-v0")
    },
    "Rooms-v0": ({"difficulty": "easy"}, GeneratorSpec().model_dump() | {"difficulty": "", "split": ""}),
    "FloorPlan-v0": ({"plan": str(LIBRARY / "furnished.json")}, PlanOptions().model_dump() | {"plan": ""}),
}
OPTIONS = ("building", "difficulty", "split", "start", "layout", "seed", "x")
SEEDS: tuple[Any, ...] = (None, 0, 3, -1, 2**31, 2**64, 2**200, 1.5, "3", np.int64(4), np.nan, [], True)


@cache
def mapped() -> tuple[Drive, SlamPipeline]:
    """A short drive, and the estimator after it."""
    short, pipeline = scripted_drive(), SlamPipeline()
    list(fed(pipeline, short, 0, 30))
    return short, pipeline


def leaves(fields: dict[str, Any], path: tuple[str, ...] = ()) -> list[tuple[tuple[str, ...], Any]]:
    """The path of each field at any depth, with its value; sections are fields, too, with a value of None."""
    found: list[tuple[tuple[str, ...], Any]] = []
    for name, value in fields.items():
        inside = isinstance(value, dict) and value
        found += [((*path, name), None if inside else value)] + (leaves(value, (*path, name)) if inside else [])
    return found


def some(fields: dict[str, Any], rng: Rng) -> dict[str, Any]:
    """One to three of the fields, at any depth, with other values; sometimes a name that is none."""
    given: dict[str, Any] = {}
    known = leaves(fields)
    for _ in range(int(rng.integers(1, 4))):
        (*sections, name), value = known[int(rng.integers(len(known)))]
        wrong = rng.random() < 0.03
        changed = {name[:-1] + "z" if wrong else name: nudged(value, rng) if rng.random() < 0.8 else odd(rng)}
        for section in reversed(sections):
            changed = {section: changed}
        given = merge(given, changed)
    return given


def nudged(value: Any, rng: Rng) -> Any:
    """A value of the same kind: a number that is somewhat or much different, the other truth value, another word."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return type(value)(value * float(rng.choice(FACTORS)))
    if isinstance(value, tuple | list) and value:
        return [nudged(item, rng) for item in value]
    return str(rng.choice(WORDS))


def odd(rng: Rng, choices: tuple[Any, ...] = ODD) -> Any:
    """One of some values of any kind."""
    return choices[int(rng.integers(len(choices)))]


def use_make(rng: Rng) -> tuple[str, Callable[[], None]]:
    """An environment with one to three other fields, and a few random steps of it."""
    name = odd(rng, tuple(IDS))
    needed, further = IDS[name]
    fields = EnvConfig().model_dump() | further
    if rng.random() < 0.1:
        fields = {"config": "", "render_mode": "", "max_steps": 3}
    given = needed | some(fields, rng)
    if not isinstance(given.get("render_mode", ""), str):
        del given["render_mode"]  # Gymnasium itself fails on other types before it calls us

    def drive() -> None:
        env = gym.make(f"mecp_env/{name}", disable_env_checker=True, **given)
        observation, _ = env.reset(seed=1)
        for _ in range(STEPS):
            assert env.observation_space.contains(observation)
            env.action_space.seed(int(rng.integers(2**31)))
            observation, reward, *_ = env.step(env.action_space.sample())
            assert np.isfinite(reward)
        env.close()

    return f"{name} {given!r:.200}", drive


def use_reset(rng: Rng) -> tuple[str, Callable[[], None]]:
    """A reset with an odd seed and options, and an odd action."""
    env = gym.make("mecp_env/Rooms-v0", disable_env_checker=True, difficulty="easy", max_steps=20)
    seed = odd(rng, SEEDS) if rng.random() < 0.5 else int(rng.integers(100))
    kinds: list[Any] = [None, {"building": 2}, {odd(rng, OPTIONS): odd(rng)}, odd(rng)]
    options = kinds[int(rng.choice(4, p=(0.3, 0.3, 0.3, 0.1)))]

    def call() -> None:
        observation, _ = env.reset(seed=seed, options=options)
        assert env.observation_space.contains(observation)
        env.step(odd(rng) if rng.random() < 0.5 else env.action_space.sample())

    return f"seed {seed!r:.40} options {options!r:.100}", call


def use_slam(rng: Rng) -> tuple[str, Callable[[], None]]:
    """An estimator with odd fields, on a short drive."""
    given = some(SlamConfig().model_dump(), rng)

    def call() -> None:
        *_, output = fed(SlamPipeline(given), mapped()[0], 0, 7)
        assert output.diverged or np.isfinite(output.belief.T_map_robot).all()

    return f"{given!r:.200}", call


CALLS = {"make": use_make, "reset and step": use_reset, "SlamConfig": use_slam}


def run(options: Options) -> Figures:
    """How inputs of each kind end, what the worst took, and the faults."""
    units = [(kind, number) for kind in CALLS for number in range(QUICK if options.quick else PER_KIND)]
    ends = in_parallel(end_of, dict[str, Any], units, options)
    pairs = list(zip(units, ends, strict=True))
    rows = {kind: summary([end for unit, end in pairs if unit[0] == kind]) for kind in CALLS}
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
    with warnings.catch_warnings(action="ignore"):
        mapped()
        what, call = CALLS[kind](rng)
        with suppress(OSError):
            FORGET_PEAK.write_text("5")
        before, start = memory_mb("VmRSS"), time.process_time()
        with limit():
            end, said = outcome(call)
    said = re.sub(r"0x[0-9a-f]+", "0x", f"{said} {what}")
    return {"end": end, "said": said, "seconds": time.process_time() - start, "mb": memory_mb("VmHWM") - before}


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
