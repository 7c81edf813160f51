"""Golden hashes of whole runs: `python -m tests.golden [CASE ...]` prints them, `--write` stores them.

The promise is "the same bits for one version on one machine type": sin, cos and atan2 of the C library differ between
processors with and without fused multiply-add, and products of matrices between the kernels that OpenBLAS has for
processors. So the hashes are stored by a probe of these functions, and `--write` stores those of each of `KERNELS`.
"""

import argparse
import hashlib
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import mecp_env  # noqa: F401  (registers the environments)
from mecp_env.config import EnvConfig
from mecp_env.planning.breadth_first import BreadthFirst
from tests.floorplans.plans import map_pair, two_rooms_picture

STORE = Path(__file__).parent / "data" / "golden.json"
KERNELS = ("Zen", "SkylakeX")  # of OpenBLAS, for processors of AMD and Intel
SEED = 7
PAPER_MAP, ROOMS = "mecp_env/PaperMap-v0", "mecp_env/Rooms-v0"
LAYOUT, FLOOR_PLAN = "mecp_env/Layout-v0", "mecp_env/FloorPlan-v0"

Step = tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]
Hashes = dict[str, str]


class Recorder:
    """Hashes a run: "run" is what the agent gets and the true pose, "metrics" is `info` and the summary."""

    def __init__(self) -> None:
        self._run, self._metrics = hashlib.sha256(), hashlib.sha256()

    def reset(self, env: gymnasium.Env, seed: int | None = None) -> dict[str, Any]:
        """The first observation of an episode, recorded."""
        observation, info = env.reset(seed=seed)
        _feed(self._run, observation)
        _feed(self._metrics, _figures(info))
        return observation

    def step(self, env: gymnasium.Env, action: Any) -> Step:
        """The result of a step, recorded."""
        result = env.step(action)
        observation, reward, _, _, info = result
        _feed(self._run, observation | {"reward": np.float64(reward), "truth": info["truth_pose"]})
        _feed(self._metrics, _figures(info))
        return result

    def hashes(self, env: gymnasium.Env) -> Hashes:
        """The hashes of the run so far, with the summary of the last episode."""
        metrics = self._metrics.copy()
        _feed(metrics, _figures(env.unwrapped.summary()))
        return {"run": self._run.hexdigest(), "metrics": metrics.hexdigest()}


MakeEnv = Callable[[], gymnasium.Env]
Drive = Callable[[MakeEnv], Hashes]


def choices(kind: str, rng: np.random.Generator) -> Callable[[int, Any, gymnasium.Env], Any]:
    """The action of a kind of drive for a step, an observation and an environment."""
    policy, held = BreadthFirst(), np.zeros(2, np.float32)

    def choose(step: int, observation: Any, env: gymnasium.Env) -> Any:
        nonlocal held
        if kind == "scripted":  # slow turns to the left and right, whatever is ahead
            return np.array([0.6, 0.4 * math.sin(0.05 * step)], np.float32)
        if kind == "discrete":  # each in turn, held for three steps, forward most often
            return (1, 3, 1, 1, 4, 1, 0, 2)[step // 3 % 8]
        if kind == "random":  # each velocity is held for eight steps, so that the robot runs into walls
            held = held if step % 8 else rng.uniform((-0.4, -0.6), (1.0, 0.6)).astype(np.float32)
            return held
        mask = env.get_wrapper_attr("action_masks")()
        return policy.act(observation, mask) if kind == "breadth first" else int(np.argmax(mask))

    return choose


def drive(make: MakeEnv, kind: str = "scripted", steps: int | None = 150) -> Hashes:
    """So many steps of a kind, over the ends of episodes; or one episode until it is complete."""
    env, recorder, choose = make(), Recorder(), choices(kind, np.random.default_rng(SEED))
    observation = recorder.reset(env, SEED)
    for step in count() if steps is None else range(steps):
        observation, _, terminated, truncated, _ = recorder.step(env, choose(step, observation, env))
        if steps is None and terminated:
            break
        if terminated or truncated:
            observation = recorder.reset(env)
    assert kind != "random" or env.unwrapped.summary()["contacts"] > 0
    return recorder.hashes(env)


def snapshot(make: MakeEnv, steps: int) -> Hashes:
    """A scripted drive continued from a snapshot in a new environment, which gives what the first one gives."""
    (env, again), here, there = (make(), make()), Recorder(), Recorder()
    choose = choices("scripted", np.random.default_rng(SEED))
    env.reset(seed=SEED)
    for step in range(steps):
        env.step(choose(step, None, env))
    again.reset(seed=SEED + 1)
    again.unwrapped.set_state(env.unwrapped.get_state())
    for one, recorder in ((env, here), (again, there)):
        for step in range(steps, 2 * steps):
            recorder.step(one, choose(step, None, one))
    assert there.hashes(again) == here.hashes(env)
    return there.hashes(again)


@dataclass(frozen=True)
class Case:
    """An environment, its keywords, and how it is driven."""

    env_id: str
    keywords: dict[str, Any] = field(default_factory=dict)
    drive: Drive = drive

    def make(self, folder: Path) -> gymnasium.Env:
        """A new environment; the plan of `FloorPlan-v0` is written to `folder`."""
        plan = {"plan": map_pair(folder, two_rooms_picture())} if self.env_id == FLOOR_PLAN else {}
        return gymnasium.make(self.env_id, **self.keywords, **plan)


TWO_ROOMS = {"layout": "two_rooms"}
QUICK = {"laser": {"sweeps": 1, "range_sigma_m": 0.01, "bearing_sigma_deg": 0.0}}
REAL = {"laser": {"preset": "urg04lx"}, "odometry": {"preset": "skid_steer", "slip_share": 0.1}}
MOVERS = {"crowd": {"people": 4}, "clutter": {"movable_boxes": 3, "closed_doors": 0.2}}
PUSHED = {"crowd": {"people": 12, "polite": False}, "clutter": {"movable_boxes": 12}}
GOALS = {"actions": "goal"}


FIRST_GOALS = partial(drive, kind="first goal", steps=12)


def _explored(**keywords: Any) -> Case:
    """The first rooms of the paper's building, breadth first."""
    return Case(PAPER_MAP, GOALS | keywords, partial(drive, kind="breadth first", steps=15))


CASES = {
    "paper_map": Case(PAPER_MAP),
    "two_rooms_1_cm": Case(LAYOUT, TWO_ROOMS | QUICK),
    "two_rooms_urg04lx": Case(LAYOUT, TWO_ROOMS | REAL),
    "paper_to_the_letter": Case(LAYOUT, {"config": EnvConfig.paper().to_dict()} | TWO_ROOMS),
    "breadth_first": Case(LAYOUT, TWO_ROOMS | GOALS, partial(drive, kind="breadth first", steps=None)),
    "breadth_first_paper_map": Case(PAPER_MAP, GOALS, partial(drive, kind="breadth first", steps=None)),
    "first_goals": Case(PAPER_MAP, GOALS, FIRST_GOALS),
    "people_and_clutter": Case(ROOMS, {"difficulty": "medium", "split": "test"} | MOVERS),
    "people_and_goals": Case(ROOMS, {"difficulty": "hard"} | GOALS | MOVERS, FIRST_GOALS),
    "pushed": Case(ROOMS, {"difficulty": "easy"} | PUSHED, partial(drive, kind="random", steps=200)),
    "floor_plan": Case(FLOOR_PLAN, {"start": "random", "observation": {"map": True, "scan": True}}),
    "ekf": _explored(slam={"filter": {"kind": "ekf"}}),
    "fej": _explored(slam={"filter": {"kind": "fej"}}),
    "one_sweep": _explored(laser={"sweeps": 1}),
    "nearest": _explored(slam={"association": {"method": "nearest"}}),
    "mecp_paper": _explored(slam={"association": {"method": "mecp_paper"}}),
    "known": _explored(estimator="known"),
    "truth": _explored(estimator="truth"),
    "random_walk": Case(PAPER_MAP, drive=partial(drive, kind="random", steps=300)),
    "discrete": Case(LAYOUT, TWO_ROOMS | {"actions": "discrete"}, partial(drive, kind="discrete")),
    "snapshot": Case(ROOMS, {"difficulty": "medium"} | MOVERS, partial(snapshot, steps=60)),
}


def probe() -> str:
    """What the C library, NumPy's vector code and its BLAS make of some angles and matrices here, in short."""
    angles = np.linspace(-7.0, 7.0, 4001)
    values = [f(a) for a in angles for f in (math.sin, math.cos, math.tan)] + [math.atan2(a, 0.3) for a in angles]
    vector = [f(angles) for f in (np.sin, np.cos, np.exp, np.arctan)] + [np.arctan2(angles, 0.3), np.hypot(angles, 0.3)]
    digest = hashlib.sha256(np.array(values).tobytes() + np.array(vector).tobytes())
    rng = np.random.default_rng(0)
    for n in (2, 3, 4, 6, 12, 30):
        rows, square = rng.normal(size=(200, n)), rng.normal(size=(n, n)) + n * np.eye(n)
        product, first = rows.T @ rows, rows[0].copy()
        solved = np.linalg.solve(square, first), np.linalg.inv(product), np.linalg.eigvalsh(product)
        for result in (product, square @ square.T, rows @ first, first @ square @ first, *solved):
            digest.update(np.ascontiguousarray(result).tobytes())
    return digest.hexdigest()[:16]


def run_hashes(case: str) -> Hashes:
    """The sha256 hashes "run" and "metrics" of a case."""
    with tempfile.TemporaryDirectory() as folder:
        return CASES[case].drive(partial(CASES[case].make, Path(folder)))


def _feed(digest: Any, arrays: dict[str, Any]) -> None:
    for name in sorted(arrays):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(arrays[name]).tobytes())


def _figures(values: dict[str, Any]) -> dict[str, np.ndarray]:
    """The finite numbers of `values`."""
    numbers = {name: value for name, value in values.items() if isinstance(value, int | float | np.number)}
    return {name: np.float64(value) for name, value in numbers.items() if math.isfinite(value)}


def stored() -> dict[str, dict[str, Hashes]]:
    """Hashes by probe, then case."""
    return json.loads(STORE.read_text()) if STORE.is_file() else {}


def kernel_hashes(kernel: str, cases: list[str]) -> dict[str, dict[str, Hashes]]:
    """Hashes by probe, then case, of a process that computes with such a kernel of OpenBLAS."""
    command = [sys.executable, "-m", "tests.golden", *cases]
    environment = os.environ | {"OPENBLAS_CORETYPE": kernel}
    return json.loads(subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True).stdout)


def main() -> None:
    """Print the hashes of this machine, or store those of each kernel of OpenBLAS with `--write`."""
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=main.__doc__)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"all by default: {', '.join(CASES)}")
    parser.add_argument("--write", action="store_true")
    args = parser.parse_args()
    if not args.write:
        print(json.dumps({probe(): {case: run_hashes(case) for case in args.cases or CASES}}, indent=1))
        return
    every = stored()
    for kernel in KERNELS:
        for machine, hashes in kernel_hashes(kernel, args.cases).items():
            every[machine] = every.get(machine, {}) | hashes
    STORE.write_text(json.dumps(every, indent=1, sort_keys=True) + "\n")


if __name__ == "__main__":
    main()
