"""Keywords of the benchmark `mutated`: fields of `make`, `reset`, `step` and `SlamConfig` with values of any kind."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks.mutated_files import FIRST, SCANS, mapped
from mecp_env.config import EnvConfig, merge
from mecp_env.evaluation.log_run import LogRunConfig
from mecp_env.floorplans.options import PlanOptions
from mecp_env.slam import SlamConfig, SlamPipeline
from mecp_env.world.config import GeneratorSpec
from mecp_env.world.layout import LIBRARY
from tests.floorplans.mutations import VALUES
from tests.slam.drives import fed

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
IDS = ("Layout-v0", "Rooms-v0", "FloorPlan-v0", "First-v0", "ActiveHalls-v0", "PaperMap-v0")
BASE: dict[str, dict[str, Any]] = {
    "FloorPlan-v0": {"plan": str(LIBRARY / "furnished.json")},
    "Rooms-v0": {"difficulty": "easy"},
}
OPTIONS = ("building", "difficulty", "split", "start", "layout", "seed", "x")
SOUND = {"building": 2}  # options of a reset
SEEDS: tuple[Any, ...] = (None, 0, 3, -1, 2**31, 2**64, 2**200, 1.5, "3", np.int64(4), np.nan, [], True)


def leaves(fields: dict[str, Any], path: tuple[str, ...] = ()) -> list[tuple[tuple[str, ...], Any]]:
    """The path of each field at any depth, with its value; sections are fields, too, with a value of None."""
    found: list[tuple[tuple[str, ...], Any]] = []
    for name, value in fields.items():
        inside = isinstance(value, dict) and value
        found += [((*path, name), None if inside else value)] + (leaves(value, (*path, name)) if inside else [])
    return found


def some(fields: dict[str, Any], count: int, rng: Rng) -> dict[str, Any]:
    """So many of the fields, at any depth, with other values; sometimes a name that is none."""
    given: dict[str, Any] = {}
    known = leaves(fields)
    for _ in range(count):
        (*sections, name), value = known[int(rng.integers(len(known)))]
        wrong = rng.random() < 0.03
        changed = {name[:-1] + "z" if wrong else name: nudged(value, rng) if rng.random() < 0.8 else odd(rng)}
        for section in reversed(sections):
            changed = {section: changed}
        given = merge(given, changed) if all(isinstance(key, str) for key in changed) else given | changed
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


def odd(rng: Rng) -> Any:
    """A value of any kind."""
    return ODD[int(rng.integers(len(ODD)))]


def use_make(rng: Rng) -> str:
    """Make an environment with one to three other fields, and take a few steps; the fields."""
    name = IDS[int(rng.integers(len(IDS)))]
    fields = EnvConfig().model_dump()
    if name == "FloorPlan-v0":
        fields |= PlanOptions().model_dump() | {"plan": ""}
    elif name not in ("Layout-v0", "PaperMap-v0"):
        fields |= GeneratorSpec().model_dump() | {"difficulty": "", "split": ""}
    if rng.random() < 0.1:
        fields = {"config": "", "render_mode": "", "max_steps": 3}
    given = BASE.get(name, {}) | some(fields, int(rng.integers(1, 4)), rng)
    if not isinstance(given.get("render_mode", ""), str):
        del given["render_mode"]  # Gymnasium itself fails on other types before it calls us
    return tried(f"{name} {given!r:.200}", lambda: drive(name, given, rng))


def tried(what: str, call: Any) -> str:
    """Call, and let an error say what was given."""
    try:
        call()
    except BaseException as error:
        error.add_note(what)
        raise
    return what


def drive(name: str, given: dict[str, Any], rng: Rng) -> None:
    """A few random steps of an environment."""
    env = gym.make(f"mecp_env/{name}", disable_env_checker=True, **given)
    observation, _ = env.reset(seed=1)
    for _ in range(STEPS):
        assert env.observation_space.contains(observation)
        env.action_space.seed(int(rng.integers(2**31)))
        observation, reward, *_ = env.step(env.action_space.sample())
        assert np.isfinite(reward)
    env.close()


def use_reset(rng: Rng) -> str:
    """Reset with an odd seed and options, and take an odd action."""
    env = gym.make("mecp_env/Rooms-v0", disable_env_checker=True, difficulty="easy", max_steps=20)
    seed = SEEDS[int(rng.integers(len(SEEDS)))] if rng.random() < 0.5 else int(rng.integers(100))
    kinds: list[Any] = [None, SOUND, {OPTIONS[int(rng.integers(len(OPTIONS)))]: odd(rng)}, odd(rng)]
    options = kinds[int(rng.choice(4, p=(0.3, 0.3, 0.3, 0.1)))]

    def call() -> None:
        observation, _ = env.reset(seed=seed, options=options)
        assert env.observation_space.contains(observation)
        env.step(odd(rng) if rng.random() < 0.5 else env.action_space.sample())

    return tried(f"seed {seed!r:.40} options {options!r:.100}", call)


def use_slam(rng: Rng) -> str:
    """An estimator with odd fields, on a short drive."""
    given = some(SlamConfig().model_dump(), int(rng.integers(1, 4)), rng)

    def call() -> None:
        LogRunConfig(**({"rest_m": odd(rng)} if rng.random() < 0.1 else {}))
        *_, output = fed(SlamPipeline(given), mapped()[0], 0, FIRST + SCANS)
        assert output.diverged or np.isfinite(output.belief.T_map_robot).all()

    return tried(f"{given!r:.200}", call)


CALLS = {"make": use_make, "reset and step": use_reset, "SlamConfig": use_slam}
