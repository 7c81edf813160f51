"""The estimator on a log: its configuration by the log's laser, the drive through the records, and the scores.

Why the result of a log is of no use, and which option to try.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from pydantic import Field, field_validator

from mecp_env.core.carriers import Array, Bools
from mecp_env.core.errors import LogError, MecpError
from mecp_env.core.se2 import between, chained, composed
from mecp_env.core.sensors import Odometry
from mecp_env.core.settings import Settings
from mecp_env.evaluation.calibration import OF_SENSOR, RANGE_SIGMA_M, UNIFORM, Calibration
from mecp_env.evaluation.trajectory import coincident, relation_error, trajectory_error
from mecp_env.logs.log import Log
from mecp_env.logs.odometry_model import arcs, end_of, reading
from mecp_env.logs.registration import registered
from mecp_env.slam.config import SlamConfig
from mecp_env.slam.messages import NO_ID
from mecp_env.slam.output import SlamOutput
from mecp_env.slam.pipeline import SlamPipeline
from mecp_env.slam.smoothing import FinalMap, Trace
from mecp_env.slam.smoothing.optimum import SmoothingError
from mecp_env.world.config import OdometryConfig

FEW_SHARE, FEWEST_SCANS = 0.1, 5  # of the scans of a file are used, at least, and at least so many
LOST_SHARE, LOST_SCANS = 0.1, 5  # of the scans at the end, and at least so many: their pose is not known
COARSEST_DEG = 17.0  # from one beam to the next, at most: sonars are no lasers
AT_REST = "scans at rest, skipped"
DAMAGED = ("damaged lines", "damaged rows", "damaged messages")


def fault_of(run: LogRun, config: LogRunConfig) -> str | None:
    """The reason and what to try, where a run diverged, was lost to its end or used few of the scans; else None."""
    if run.ended == "diverged":
        return (
            f"diverged at {run.t[-1]:.3f} s: the odometry may be worse than its covariance: "
            "try --noise.scale 3, or --odometry none"
        )
    if run.ended != "complete":
        return None
    return _few(run, config) or _lost(run) or _empty(run)


def _few(run: LogRun, config: LogRunConfig) -> str | None:
    """Where fewer than five scans, or than a tenth of them, are used."""
    if len(run.log) < FEWEST_SCANS:
        return f"only {len(run.log)} of the scans can be used: a map takes a drive, and scans on the way"
    counts = run.counts
    found = run.log.found + sum(counts.get(name, 0) for name in DAMAGED)
    standard = LogRunConfig()
    asked = config.rest_m > standard.rest_m or config.rest_deg > standard.rest_deg or config.scans is not None
    resting = counts.get(AT_REST, 0)
    if len(run.t) + resting * asked >= max(FEWEST_SCANS, FEW_SHARE * found):
        return None
    reason = f"{len(run.t)} of {found} scans are used"
    if 2 * resting > found and REGISTERED in run.notes:
        return f"{reason}, the robot is at rest by its scans in {resting}: a map takes a drive"
    if 2 * resting > found:
        return f"{reason}, the robot is at rest by its odometry in {resting}: try --odometry none"
    return f"{reason}: try --clock received, or --odometry none; what is left out is counted above"


def _lost(run: LogRun) -> str | None:
    """Where the pose is not known at the end."""
    known = np.flatnonzero(run.localised)
    last = int(known[-1]) if len(known) else -1
    lost = len(run.localised) - 1 - last
    if lost < max(LOST_SCANS, LOST_SHARE * len(run.localised)):
        return None
    since = f"from {run.t[last + 1]:.3f} s" if last >= 0 else "in the whole log"
    return (
        f"the pose is lost {since} to the end, nothing is mapped there: try --noise.scale 3, "
        "--config.localisation.explained-share 0 or --odometry none"
    )


def _empty(run: LogRun) -> str | None:
    """Where no scan shows a corner."""
    if len(run.output.belief.ids):
        return None
    return (
        "no landmark: no scan shows corners of walls, and the path is that of the odometry: try another --max-range-m "
        "or --field-of-view-deg, or a drive through rooms"
    )


REGISTERED = (
    "odometry none: it is made by registration of successive scans, which cannot show whether the laser counts "
    "clockwise: --mirror where the map is mirrored"
)


class LogRunConfig(Settings):
    """How a log is fed to the estimator."""

    odometry: Literal["log", "reference", "none"] = "log"  # reference: of the reference path, with noise of `noise`;
    # none: made by registration of successive scans, as for a log without odometry
    noise: OdometryConfig = OdometryConfig()  # per metre: what the covariance of a reading is computed from, where no
    # calibration says more of the odometry of the log
    seed: int = Field(0, ge=0)  # of that noise
    rest_m: float = Field(0.001, ge=0.0, le=1.0)  # a scan is skipped where the robot has moved less than this, and
    rest_deg: float = Field(0.05, ge=0.0, le=45.0)  # turned less than this, since the last one that was used
    first: int = Field(0, ge=0)  # record to begin with
    scans: int | None = Field(None, ge=1)  # records at most

    @field_validator("noise")
    @classmethod
    def _grows_with_the_path(cls, noise: OdometryConfig) -> OdometryConfig:
        """Steps of a log have any length: noise per step or in proportion to it would depend on how they are cut."""
        if noise.reading != "per_metre":
            raise ValueError(f"reading: {noise.reading!r}, per_metre expected")
        return noise


@dataclass(frozen=True, slots=True, eq=False)
class LogRun:
    """The result of the estimator on a log, or on its first part."""

    log: Log
    pipeline: SlamPipeline
    output: SlamOutput  # after the last scan
    ended: str  # complete, diverged, interrupted, or an error
    t: Array  # (n,) s, of the scans that were used
    T_map_robot: Array  # (n,3) m, rad: estimated when each was taken
    T_ref_robot: Array | None  # (n,3) m, rad
    T_odom_robot: Array  # (n,3) m, rad: dead reckoning from the first scan on, as the estimator got it
    localised: Bools  # (n,)
    polygon: Bools  # (n,) a polygon was found
    step_s: Array  # (n,) processor time of each scan
    counts: Mapping[str, int]  # those of the log, and of what was left out here
    notes: tuple[str, ...] = ()  # those of the log, and of what was chosen here
    calibration: Calibration | None = None  # by which the odometry of the log was corrected
    final: FinalMap | None = None  # path and map smoothed over all scans; None where the optimum is not reached
    final_s: float = 0.0  # processor time of the smoothing

    def metrics(self) -> dict[str, Any]:
        """The figures of the run; those against a reference or relations only where the log has them."""
        found: dict[str, Any] = {
            "ended": self.ended,
            "scans": len(self.t),
            "log_share": float((self.t[-1] - self.log.t[0]) / max(self.log.t[-1] - self.log.t[0], 1e-9)),
            "seconds": float(self.t[-1] - self.t[0]),
            "metres": float(np.hypot(*np.diff(self.T_map_robot[:, :2], axis=0).T).sum()),
            "landmarks": len(self.output.belief.ids),
            "landmarks_dropped": self.dropped,
            "rooms": len(self.output.graph.rooms),
            "doors": len(self.output.graph.doors),
            "polygon_share": float(self.polygon.mean()),
            "localised_share": float(self.localised.mean()),
            "resumed": self.pipeline.guard.resumed,
            "ms_per_scan_median": 1e3 * float(np.median(self.step_s)),
            "ms_per_scan_mean": 1e3 * float(self.step_s.mean()),
        }
        errors, smoothed = (self._errors(poses) for poses in (self.T_map_robot, self.T_final_robot))
        smoothed.pop("dead_reckoning_ate_m", None)
        final = {f"final_{name}": value for name, value in smoothed.items() if name.endswith(("_m", "_deg"))}
        steps = 0 if self.final is None else self.final.steps
        final |= {"final_converged": self.final is not None, "final_steps": steps, "final_s": self.final_s}
        said = {"counts": dict(self.counts), "notes": list(self.notes)}
        calibration = {} if self.calibration is None else {"calibration": self.calibration.as_dict()}
        return found | errors | final | said | calibration

    @property
    def T_final_robot(self) -> Array:
        """(n,3) m, rad: the smoothed poses; those of `T_map_robot` where there are none."""
        return self.T_map_robot if self.final is None else self.final.T_map_robot

    @property
    def final_output(self) -> SlamOutput:
        """The output after the last scan with the smoothed landmarks, pose and grid; as it is where there are none."""
        if self.final is None:
            return self.output
        return replace(self.output, belief=self.final.belief, grid=self.final.grid)

    @property
    def dropped(self) -> int:
        """Landmarks that found no room in the filter."""
        return int(getattr(self.pipeline.filter, "dropped", 0))

    @property
    def T_robot_frame(self) -> Array:
        """(3,) the frame in which the log is scored, on the robot as the estimator knows it.

        It is the robot's as the log describes it. Where the log says nothing of the mounting, that is the laser: its
        path is what a reference is made of.
        """
        return composed(self.pipeline.config.sensor.T_robot_laser, between(self.log.T_robot_laser, np.zeros(3)))

    @property
    def scored(self) -> slice:
        """The scans from the first on whose pose was known."""
        return slice(int(self.localised.argmax()), None)

    def _errors(self, T_map_robot: Array) -> dict[str, float]:
        """Those of poses (n,3) against the reference path and relations, as far as the log has these.

        Of all relations, with interpolated poses, and of those that need no interpolation.
        """
        found = dict[str, float]()
        if not self.localised.any():
            return found
        t, paths = self.t[self.scored], (T_map_robot, self.T_odom_robot)
        slam, dead = (composed(poses[self.scored], self.T_robot_frame) for poses in paths)
        if self.T_ref_robot is not None:
            reference = self.T_ref_robot[self.scored]
            ate = trajectory_error(slam, reference)
            found |= {"ate_m": ate.rmse_m, "ate_worst_m": ate.worst_m, "ate_deg": math.degrees(ate.rmse_rad)}
            found["dead_reckoning_ate_m"] = trajectory_error(dead, reference).rmse_m
        both = {"relations": self.log.relations, "relations_at_scans": coincident(self.log.t, self.log.relations)}
        for name, relations in both.items():
            if len(relations):
                error = relation_error(t, slam, relations)
                found |= {name: error.relations, f"{name}_m": error.mean_m, f"{name}_sd_m": error.sd_m}
                found |= {f"{name}_deg": math.degrees(error.mean_rad), f"{name}_sd_deg": math.degrees(error.sd_rad)}
        return found


def sensor_of(log: Log, given: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Fields of the estimator's sensor model by the log's laser, but for those that are `given`. Raises `LogError`."""
    step_deg = math.degrees(log.step_rad)
    if step_deg > COARSEST_DEG:
        raise LogError(
            f"{log.name}: laser: {len(log.bearings)} beams {step_deg:.3g} deg apart show no corners of walls, "
            f"at most {COARSEST_DEG:g} deg expected"
        )
    sigmas = {"range_sigma_m": RANGE_SIGMA_M, "bearing_sigma_deg": step_deg / UNIFORM}
    return log.sensor() | sigmas | dict(given or {})


def config_for(log: Log, fields: Mapping[str, Any] | None = None, calibration: Calibration | None = None) -> SlamConfig:
    """The configuration of the estimator for a log, and for what a `calibration` found of its laser.

    `fields` of `SlamConfig` override both.
    """
    fields = dict(fields or {})
    found = {} if calibration is None else calibration.sensor.model_dump(include=set(OF_SENSOR))
    return SlamConfig.parse(fields | {"sensor": sensor_of(log, found | dict(fields.get("sensor", {})))})


@dataclass(slots=True, eq=False)
class LogDrive:
    """A run in progress: the estimator and what it has said so far."""

    log: Log
    pipeline: SlamPipeline
    config: LogRunConfig
    calibration: Calibration | None = None  # of the odometry of the log
    rows: list[int] = field(default_factory=list)  # of the log, that were used
    outputs: list[tuple[Array, bool, bool, float]] = field(default_factory=list)
    """Of each scan the pose (3,), whether it is known, whether there is a polygon, and the time in s."""
    measured: list[Array] = field(default_factory=list)  # (3,) of each scan the motion that the odometry measured
    output: SlamOutput | None = None
    ended: str = "interrupted"
    trace: Trace = field(init=False)

    def __post_init__(self) -> None:
        """Make odometry of the scans where there is none. Raises `LogError` where the log lacks what is asked for."""
        if self.config.odometry == "none" or (self.config.odometry == "log" and self.log.T_odom_robot is None):
            self.log = replace(registered(self.log), notes=(*self.log.notes, REGISTERED))
        self._path()
        self.trace = Trace(self.pipeline)

    def _path(self) -> Array:
        """(n,3) the poses that the odometry is made of."""
        path = self.log.T_ref_robot if self.config.odometry == "reference" else self.log.T_odom_robot
        if path is None:
            raise LogError(f"{self.log.name}: odometry: the log has no reference path to make it of")
        return path

    @property
    def _last(self) -> int:
        """The record behind the last one that is asked for."""
        return min(self.config.first + (self.config.scans or len(self.log)), len(self.log))

    def planned(self) -> list[int]:
        """The rows of the log that will be used: those with a pose, without those at rest."""
        path, config, rows = self._path(), self.config, list[int]()
        for row in (config.first + np.flatnonzero(np.isfinite(path[config.first : self._last, 0]))).tolist():
            if not rows or self._moved(path[rows[-1]], path[row]):
                rows.append(row)
        if not rows:
            raise LogError(f"{self.log.name}: no scan with a pose from record {config.first} on")
        return rows

    def _moved(self, T_before: Array, T_after: Array) -> bool:
        dx, dy, turn = (T_after - T_before).tolist()
        turned = abs(math.remainder(turn, 2.0 * math.pi))
        return math.hypot(dx, dy) >= self.config.rest_m or turned >= math.radians(self.config.rest_deg)

    def steps(self) -> Iterator[SlamOutput]:
        """The output for each scan. An error of the estimator ends the run, and what there was is kept."""
        rng = np.random.default_rng(self.config.seed) if self.config.odometry == "reference" else None
        rows = self.planned()
        try:
            for before, row in zip([-1, *rows], rows, strict=False):
                yield self._step(row, None if before < 0 else self._odometry(before, row, rng))
                if self.output is not None and self.output.diverged:
                    self.ended = "diverged"
                    return
        except MecpError as error:
            self.ended = f"error: {error}"
            return
        self.ended = "complete"

    def _odometry(self, before: int, row: int, rng: np.random.Generator | None) -> Odometry:
        path = self._path()
        motion = between(path[before], path[row])
        if self.calibration is None:
            return reading(arcs(motion), self.config.noise, rng)
        model = self.calibration.odometry
        return reading(arcs(model.corrected(motion)), model)

    def _step(self, row: int, odometry: Odometry | None) -> SlamOutput:
        scan, start = self.log.scan(row), time.thread_time()
        output = self.pipeline.start(scan) if odometry is None else self.pipeline.step(odometry, scan)
        spent = time.thread_time() - start
        self.rows.append(row)
        self.outputs.append((output.belief.T_map_robot.copy(), output.localised, bool(output.polygons), spent))
        self.measured.append(np.zeros(3) if odometry is None else end_of(odometry.increments))
        self.trace.add(odometry, output)
        self.output = output
        return output

    def _unsure(self) -> tuple[str, ...]:
        """What was mapped although the pose was not found again."""
        times, output = self.pipeline.guard.resumed, self.output
        if not times or output is None:
            return ()
        said = f"the pose was lost and mapping went on where odometry said ({times} times)"
        if output.unsure_from == NO_ID:
            return (f"{said}; known landmarks were recognised since",)
        unsure = int(np.count_nonzero(output.belief.ids >= output.unsure_from))
        return (f"{said}; {unsure} landmarks are not joined to the earlier map since",)

    def result(self) -> LogRun:
        """The run so far. Raises `LogError` before the first scan."""
        if self.output is None:
            raise LogError(f"{self.log.name}: no scan was used ({self.ended})")
        poses, localised, polygon, spent = map(np.array, zip(*self.outputs, strict=True))
        start = time.thread_time()
        final, said = self._final()
        last = self._last if self.ended == "complete" else self.rows[-1] + 1
        resting = last - self.rows[0] - len(self.rows)
        return LogRun(
            log=self.log,
            pipeline=self.pipeline,
            output=self.output,
            ended=self.ended,
            t=self.log.t[self.rows],
            T_map_robot=poses,
            T_ref_robot=None if self.log.T_ref_robot is None else self.log.T_ref_robot[self.rows],
            T_odom_robot=chained(np.array(self.measured)[1:]),
            localised=localised,
            polygon=polygon,
            step_s=spent,
            counts=dict(self.log.counts) | ({AT_REST: resting} if resting else {}),
            notes=self.log.notes + self._unsure() + said,
            calibration=self.calibration,
            final=final,
            final_s=time.thread_time() - start,
        )

    def _final(self) -> tuple[FinalMap | None, tuple[str, ...]]:
        """Path and map smoothed over all scans so far, and what is said of it."""
        try:
            return self.trace.final(), ()
        except SmoothingError as error:
            return None, (f"final trajectory: {error}; trajectory_final.tum is the online one",)


def run_log(
    log: Log,
    config: SlamConfig | Mapping[str, Any] | None = None,
    run: LogRunConfig | None = None,
    pipeline: SlamPipeline | None = None,
    after: Callable[[SlamOutput], None] | None = None,
    calibration: Calibration | None = None,
) -> LogRun:
    """The estimator on a whole log; raises `LogError` where the log lacks what `run` asks for.

    `config`: fields of `SlamConfig` that override the log's laser, or a whole `SlamConfig`, which is taken as it is.
    `pipeline`: one to go on with, as from a saved map, in place of a new one. `after` is called after every scan.
    `calibration`: that of the log's odometry and laser (`calibrate_log`); without one, odometry is taken as it is, with
    the noise of `run`.
    """
    slam = config if isinstance(config, SlamConfig) else config_for(log, config, calibration)
    drive = LogDrive(log, pipeline or SlamPipeline(slam), run or LogRunConfig(), calibration)
    for output in drive.steps():
        if after is not None:
            after(output)
    return drive.result()
