"""The commands `slam` and `export`: the estimator on a recorded log, and what is in a saved map, for other programs."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import tyro
from pydantic import Field

from mecp_env.cli.base import (
    FAILED,
    INTERRUPTED,
    Command,
    Line,
    Seed,
    as_note,
    check_folder,
    check_writable,
    echo,
    print_error,
)
from mecp_env.cli.options import KeepsMap, named_fields, spare_sources
from mecp_env.core.errors import ConfigError
from mecp_env.slam.config import SlamConfig
from mecp_env.world.config import OdometryConfig

if TYPE_CHECKING:
    from mecp_env.evaluation.calibration import Calibration
    from mecp_env.evaluation.log_run import LogRun, LogRunConfig
    from mecp_env.logs import Log
    from mecp_env.slam import SlamPipeline
    from mecp_env.slam.map_file import MapStart

POSE = "expected saved, unknown or a pose as X,Y,HEADING in m and rad"


class SlamFields(SlamConfig):
    """Any field of the estimator; what is not given follows the laser of the log."""


class NoiseFields(OdometryConfig):
    """Noise of the odometry per square root of a metre, and what is corrected; given fields win over `--noise auto`."""

    reading: Annotated[Literal["per_metre"], tyro.conf.Suppress] = "per_metre"
    distance_scale: float = Field(1.0, ge=0.1, le=10.0)  # true distance per distance of the odometry
    turn_scale: float = Field(1.0, ge=0.1, le=10.0)  # true turn per turn of the odometry
    turn_bias_deg_per_m: float = Field(0.0, ge=-90.0, le=90.0)  # true turn per metre straight ahead by the odometry


SlamFields.__name__, NoiseFields.__name__ = "--config", "--noise"  # errors then name the option


@dataclass(frozen=True)
class Slam(KeepsMap):
    """Map a recorded log: a CARMEN log, a ROS 1 or ROS 2 bag, or a NumPy archive; keep pictures, figures and paths.

    Examples:
        mecp-env slam intel.log
        mecp-env slam office.bag --scan-topic /front/scan --out runs/office
        mecp-env slam fr079.npz --odometry reference --seed 1 --save-map fr079.zip
        mecp-env slam monday.bag --from-map fr079.zip --start unknown
        mecp-env slam intel.log --config.sensor.range-sigma-m 0.03 --config.sensor.x-m 0.1
        mecp-env slam intel.log --noise.turn-sigma-deg 4.5 --noise.distance-scale 1.02
        mecp-env slam intel.log --noise paper
    """

    log: Annotated[Path, tyro.conf.Positional]
    out: Path | None = None  # folder for what is kept; default: runs/slam-NAME
    odometry: Literal["log", "reference", "none"] = "log"  # reference: of the log's reference path, with noise of
    # --noise; none: by registration of successive scans, as in a log without any
    seed: Seed = 0  # of that noise
    scan_topic: tyro.conf.UseAppendAction[tuple[str, ...]] = ()  # of a bag with several lasers; given more than once,
    # they are merged; the laser message of a CARMEN log
    scan_frame: str | None = None  # of a bag whose scans have several frames: the one to read
    odometry_topic: str | None = None  # of a bag with several
    clock: Literal["message", "received"] = "message"  # received: the order of the file counts, not the stamps; in a
    # bag the times when messages were received
    mirror: bool = False  # the laser turns clockwise, or hangs upside down
    laser_yaw_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = 0.0  # added to the heading of the laser on the robot
    max_range_m: Annotated[float, Field(gt=0.0, le=1000.0)] | None = None  # readings from here on are no return
    field_of_view_deg: Annotated[float, Field(ge=10.0, le=360.0)] | None = None  # of FLASER lines; others are cut to it
    rest_m: Annotated[float, Field(ge=0.0, le=1.0)] = 0.001  # scans after less motion than this,
    rest_deg: Annotated[float, Field(ge=0.0, le=45.0)] = 0.05  # and less turn than this, are skipped
    from_map: Path | None = None  # a saved map to go on in
    start: str = "saved"  # where, in that map: saved, unknown (it is searched for), or a pose as X,Y,HEADING
    config: SlamFields = field(default_factory=SlamFields)  # any field of the estimator
    noise_from: Annotated[Literal["auto", "paper"], tyro.conf.arg(name="noise")] = "auto"  # auto: found by registration
    # of the log's scans, with scale and bias of its odometry and mounting of its laser; paper: nothing is corrected
    noise: NoiseFields = field(default_factory=NoiseFields)

    def run(self, line: Line) -> int:
        """Map the log with a progress bar; after Ctrl-C, or where the estimator fails, keep what there is."""
        from mecp_env.cli.runs import LOG_FILES, LogFiles, print_figures  # here, so that help and errors come at once
        from mecp_env.core.warm_up import prepare
        from mecp_env.evaluation.log_run import REGISTERED, LogDrive
        from mecp_env.render.progress import Bar

        folder = check_folder(self.out or Path("runs") / f"slam-{self.log.stem}")
        spare_sources([folder / name for name in LOG_FILES], [str(path) for path in (self.log, self.from_map) if path])
        self.check_map(str(self.log), "slam")
        log, fault = self._read()
        fields, noise = named_fields(self.config, line, "--config."), named_fields(self.noise, line, "--noise.")
        pipeline, calibration = self._estimator(log, fields, partial(self._calibration, log, noise, fault))
        options = self._options(noise)
        drive = LogDrive(log, pipeline, options, calibration)
        log = drive.log
        echo(*[f"note: {REGISTERED}"] * (REGISTERED in log.notes))
        print_calibration(calibration)
        planned = len(drive.planned())
        prepare()
        files = LogFiles(log, planned, self.recording())
        echo(f"mapping {log.name}")
        with Bar(planned) as bar, suppress(KeyboardInterrupt):
            for output in drive.steps():
                files.look(output, drive.rows[-1])
                files.show(bar)
        self.end_recording(files.rerun)
        if drive.output is None and drive.ended == "interrupted":
            return INTERRUPTED
        run = drive.result()
        code = self.keep_map(run.pipeline)
        metrics = files.keep(folder, run, self._recipe(run, options))
        print_figures(f"log {run.ended}", metrics, folder)
        return max(self._ended(run, options, fault), code)

    def _options(self, noise: dict[str, Any]) -> LogRunConfig:
        from mecp_env.evaluation.log_run import LogRunConfig

        of_path = OdometryConfig(**{key: noise[key] for key in OdometryConfig.model_fields if key in noise})
        keys = "odometry", "seed", "rest_m", "rest_deg"
        return LogRunConfig(noise=of_path, **{key: getattr(self, key) for key in keys})

    def _ended(self, run: LogRun, options: LogRunConfig, of_laser: str | None) -> int:
        """The exit code, with the reason where the result is of no use, and what is wrong with the laser."""
        from mecp_env.evaluation.log_run import fault_of

        fault = fault_of(run, options)
        if fault is not None:
            print_error("; ".join((f"{self.log}: {fault}", *filter(None, [of_laser]))))
            return FAILED
        return {"interrupted": INTERRUPTED, "complete": 0}.get(run.ended, FAILED)

    def _read(self) -> tuple[Log, str | None]:
        """The log, by the options for its format, and what is wrong with its laser; notes are printed.

        Raises `LogError`.
        """
        from mecp_env.logs import ReadOptions, read_log
        from mecp_env.logs.laser_check import laser_fault

        given = {name: value for name, value in vars(self).items() if name in ReadOptions.model_fields}
        given |= {"scan_topic": self.scan_topic or None, "use_odometry": self.odometry != "none"}
        log = read_log(self.log, ReadOptions(**given))
        echo(*map(as_note, log.notes))
        fault = laser_fault(log, self.noise.distance_scale) if self.odometry == "log" else None
        said = () if fault is None else (f"warning: {fault}",)
        echo(*said)
        return replace(log, notes=(*log.notes, *said)), fault

    def _estimator(
        self, log: Log, fields: dict[str, Any], calibrate: Callable[[SlamConfig, dict[str, Any]], Calibration | None]
    ) -> tuple[SlamPipeline, Calibration | None]:
        """A new estimator for the log's laser, or one in a saved map, and the calibration of the odometry, if any.

        Raises `ConfigError` and `MapError`.
        """
        from mecp_env.evaluation.log_run import config_for
        from mecp_env.slam import SlamPipeline

        if self.from_map is None:
            if self.start != "saved":
                raise ConfigError(f"--start: {self.start} is a place in a map; name one by --from-map")
            calibration = calibrate(config_for(log, fields), fields.get("sensor", {}))
            return SlamPipeline(config_for(log, fields, calibration)), calibration
        if fields:
            raise ConfigError(f"--config: {', '.join(fields)} given, but a map has its own configuration (--from-map)")
        pipeline = SlamPipeline.from_map(self.from_map, self._start())
        return pipeline, calibrate(pipeline.config, pipeline.config.sensor.model_dump())

    def _calibration(
        self, log: Log, noise: dict[str, Any], fault: str | None, config: SlamConfig, sensor: dict[str, Any]
    ) -> Calibration | None:
        """That of the log's odometry and laser; None where it is not asked for, or where there is no odometry.

        `config` describes the laser; fields of `sensor` are kept.
        """
        from mecp_env.evaluation.calibration import CORRECTIONS, OF_SENSOR, calibrate_log

        if self.noise_from == "auto" and self.odometry == "log" and log.T_odom_robot is not None:
            given = {name: float(sensor[name]) for name in OF_SENSOR if name in sensor}
            return calibrate_log(log, config, given, noise, fault)
        useless = [name for name in CORRECTIONS if name in noise]
        if useless:
            said = ", ".join(useless)
            raise ConfigError(f"--noise: {said} given, but only --noise auto corrects odometry of the log")
        return None

    def _start(self) -> MapStart:
        """Where to begin in the map. Raises `ConfigError`."""
        if self.start in ("saved", "unknown"):
            return cast("MapStart", self.start)
        try:
            x, y, heading = map(float, self.start.split(","))
        except ValueError:
            raise ConfigError(f"--start: {self.start!r:.60}, {POSE}") from None
        return (x, y, heading)

    def _recipe(self, run: LogRun, options: Any) -> dict[str, Any]:
        """What another run needs to give the same."""
        start = {"from_map": str(self.from_map), "start": self.start} if self.from_map is not None else {}
        found = {} if run.calibration is None else {"odometry": run.calibration.odometry.model_dump()}
        config = run.pipeline.config.model_dump()
        return {"log": str(self.log), **start, "run": options.model_dump(), **found, "config": config}


def print_calibration(calibration: Calibration | None) -> None:
    """Print each value with its standard deviation and source, and why defaults are used; nothing without one."""
    if calibration is None:
        return
    from rich.console import Console
    from rich.table import Column, Table

    title = f"calibration by {calibration.registered} of {calibration.tried} motions between scans"
    value, sigma = (Column(name, justify="right") for name in ("value", "sigma"))
    table = Table("field", value, sigma, "source", title=title, title_justify="left")
    for name, estimate in calibration.estimates.items():
        spread = "" if estimate.sigma is None else f"{estimate.sigma:.4f}"
        table.add_row(name, f"{estimate.value:.4f}", spread, estimate.source)
    if calibration.range_noise_m is not None:
        table.add_row("range noise on straight walls, m", f"{calibration.range_noise_m:.4f}", "", "measured")
    Console().print(table)
    echo(*map(as_note, calibration.notes))


@dataclass(frozen=True)
class Export(Command):
    """Write landmarks, rooms, a graph or the grid of a saved map (--save-map) for other programs.

    Examples:
        mecp-env export map.zip --landmarks x.csv --rooms x.geojson
        mecp-env export map.zip --joint-covariance x.npz
    """

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="MAP")]
    landmarks: Path | None = None  # .csv: position and covariance of each landmark
    joint_covariance: Path | None = None  # .npz or .csv: of the pose and all landmarks
    rooms: Path | None = None  # .geojson: outlines of rooms and doors, in metres of the map frame
    g2o: Path | None = None  # .g2o: the pose and the landmarks as a graph
    grid: Path | None = None  # .yaml: the grid for map_server, with its .pgm beside it

    def run(self, line: Line) -> int:
        """Read the map, write every file that is asked for, a line each."""
        from mecp_env.slam import SlamMap, SlamPipeline
        from mecp_env.slam.export import checked

        wanted = {name: path for name in NAMES if (path := getattr(self, name)) is not None}
        if not wanted:
            raise ConfigError(f"export: name what to write, one or more of {', '.join(map(option, NAMES))}")
        checked({**wanted})
        for name, path in wanted.items():
            check_writable(path, option(name))
        images = [self.grid.with_suffix(".pgm")] if self.grid is not None else []
        spare_sources([*wanted.values(), *images], [str(self.source)])
        pipeline = SlamMap.load(self.source).restore(SlamPipeline)
        for name, path in wanted.items():
            pipeline.export(**{name: path})
            echo(f"{name}: {path}")
        return 0


def option(name: str) -> str:
    """The option of a field."""
    return f"--{name.replace('_', '-')}"


NAMES = ("landmarks", "joint_covariance", "rooms", "g2o", "grid")
