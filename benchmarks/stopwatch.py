"""How long each stage of a step takes, without a line about time in the stages themselves."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import event

import mecp_env.env
import mecp_env.slam.pipeline
from mecp_env.episode.observations import Observer
from mecp_env.evaluation.metrics import EpisodeMetrics
from mecp_env.lab.mecp_paper import MecpPaperAssociator
from mecp_env.lab.rivals import NearestAssociator
from mecp_env.planning.navigator import Navigator
from mecp_env.slam.association.mecp import MecpAssociator
from mecp_env.slam.association.oracle import OracleAssociator
from mecp_env.slam.filters.core import LandmarkFilter
from mecp_env.slam.grid import GridPainter
from mecp_env.slam.pipeline import SlamPipeline
from mecp_env.world.laser import Laser
from mecp_env.world.simulation import Simulation

env: Any = mecp_env.env
pipeline: Any = mecp_env.slam.pipeline

ASSOCIATORS = MecpAssociator, MecpPaperAssociator, NearestAssociator, OracleAssociator
# stage -> a function or method that is it, where the environment and the pipeline look it up; none calls another
STAGES: tuple[tuple[str, Any, str], ...] = (
    ("simulation", Simulation, "step"),
    ("laser", Laser, "scan"),
    ("odometry", env, "measure"),
    ("front end", pipeline, "front_end"),
    ("polygons", pipeline, "find_structure"),
    *(("association", kind, "associate") for kind in ASSOCIATORS),
    ("filter predict", LandmarkFilter, "predict"),
    ("filter update", LandmarkFilter, "update"),
    ("map growth", SlamPipeline, "_extend_map"),
    ("grid", GridPainter, "paint"),
    ("goals", env, "find_goals"),
    ("truth metrics", EpisodeMetrics, "look"),
    ("rewards", env, "measured_terms"),
    ("observation", Observer, "observe"),
    ("info", env.MecpEnv, "info"),
)
STAGE_NAMES = tuple(dict.fromkeys(name for name, _, _ in STAGES))
STEPS = (("step", env.MecpEnv, "step"), ("step", env.MecpEnv, "advance"))  # the first calls the second; a drive, too
DRIVE = ("drive", Navigator, "step")
SEARCH = ("drive", env.MecpEnv, "refresh_goals")  # after a drive; within a step it is part of that


class Stopwatch:
    """Seconds of each stage so far, on the clock of this thread's processor, so that another load does not count.

    Steps in which numba compiled or loaded a function are left out. `compilations` hears of these: to count what there
    is after every step took 0.1 ms, and left the next step with cold caches.
    """

    def __init__(self) -> None:
        self.compilations = event.RecordingListener()
        self.seconds = dict.fromkeys([*STAGE_NAMES, "step", "drive"], 0.0)
        self.steps = 0
        self._step = dict.fromkeys(self.seconds, 0.0)  # of this step so far
        self._stepping = False

    @property
    def steps_per_s(self) -> float:
        """Control steps of the environment per second; 0 before the first."""
        return self.steps / self.seconds["step"] if self.steps else 0.0

    def microseconds(self) -> dict[str, float]:
        """Mean time of each stage in a control step, us; `rest` is what of `step` is no stage."""
        times = {name: 1e6 * seconds / max(self.steps, 1) for name, seconds in self.seconds.items()}
        return times | {"rest": times["step"] - sum(times[name] for name in STAGE_NAMES)}

    def around(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """`function`, whose time counts for `stage`."""

        @functools.wraps(function)
        def timed(*args: Any, **keywords: Any) -> Any:
            if self._stepping and stage in ("step", "drive"):
                return function(*args, **keywords)
            self._stepping |= stage == "step"
            name = stage if self._stepping else "drive"  # between two steps: goals are looked for, a way is planned
            start = time.thread_time()
            try:
                return function(*args, **keywords)
            finally:
                self._step[name] += time.thread_time() - start
                if stage == "step":
                    self._end_step()

        return timed

    def _end_step(self) -> None:
        if not self.compilations.buffer:
            self.steps += 1
            for name, seconds in self._step.items():
                self.seconds[name] += seconds
        self._step = dict.fromkeys(self.seconds, 0.0)
        self.compilations.buffer.clear()
        self._stepping = False


@contextmanager
def timed_stages(*, each: bool = True) -> Iterator[Stopwatch]:
    """A stopwatch that runs within this block, for all environments of this process.

    It costs 2 us per call; with `each=False` only whole steps and drives are timed.
    """
    watch = Stopwatch()
    timed = (*STAGES, *STEPS, DRIVE) if each else (*STEPS, DRIVE, SEARCH)
    plain = [(stage, owner, name, getattr(owner, name)) for stage, owner, name in timed]
    try:
        for stage, owner, name, function in plain:
            setattr(owner, name, watch.around(stage, function))
        with event.install_listener("numba:compiler_lock", watch.compilations):
            yield watch
    finally:
        for _, owner, name, function in plain:
            setattr(owner, name, function)
