"""`mecp-env slam`: the estimator on a recorded log."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import tyro
from pydantic import Field

from mecp_env.cli.base import Seed, check_folder
from mecp_env.cli.exit_codes import FAILED, INTERRUPTED, echo, exit_code, print_error
from mecp_env.cli.fields import named_fields
from mecp_env.cli.with_option import WithModules
from mecp_env.core.errors import ConfigError
from mecp_env.slam.config import SlamConfig
from mecp_env.world.config import OdometryConfig

if TYPE_CHECKING:
    from mecp_env.evaluation.log_run import LogDrive, LogRun, LogRunConfig
    from mecp_env.logs import Log
    from mecp_env.slam import SlamPipeline
    from mecp_env.slam.map_file import MapStart

POSE = "expected saved, unknown or a pose as X,Y,HEADING in m and rad"


class SlamFields(SlamConfig):
    """Any field of the estimator; what is not given follows the laser of the log."""


class NoiseFields(OdometryConfig):
    """Noise of the odometry, per square root of a metre: of the one that is made, and in the covariance of all."""

    reading: Annotated[Literal["per_metre"], tyro.conf.Suppress] = "per_metre"


SlamFields.__name__, NoiseFields.__name__ = "--config", "--noise"  # errors then name the option


@dataclass(frozen=True)
class Slam(WithModules):
    """Map a recorded log: a CARMEN log, a ROS 1 or ROS 2 bag, or a NumPy archive; keep pictures, figures and paths."""

    examples: ClassVar[tuple[str, ...]] = (
        "mecp-env slam intel.log",
        "mecp-env slam office.bag --scan-topic /front/scan --out runs/office",
        "mecp-env slam fr079.npz --odometry reference --seed 1 --save-map fr079.zip",
        "mecp-env slam monday.bag --from-map fr079.zip --start unknown",
        "mecp-env slam intel.log --config.sensor.range-sigma-m 0.03 --config.sensor.x-m 0.1",
    )

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
    rerun: Path | None = None  # file for a recording of the rerun viewer (.rrd)
    save_map: Path | None = None  # file for the map, which the estimator can localise in (a .zip)
    config: SlamFields = field(default_factory=SlamFields)  # any field of the estimator
    noise: NoiseFields = field(default_factory=NoiseFields)

    keeps_results = True

    def run(self, line: Sequence[str]) -> int:
        """Map the log with a progress bar; after Ctrl-C, or where the estimator fails, keep what there is."""
        from mecp_env.cli.buildings import spare_sources
        from mecp_env.cli.log_files import FILES, LogFiles, MappingBar, print_result
        from mecp_env.cli.map_option import check_map, save_map
        from mecp_env.cli.rerun_option import end_rerun, rerun_log
        from mecp_env.core import warm_up
        from mecp_env.evaluation.log_run import LogDrive, LogRunConfig

        folder = check_folder(self.out or Path("runs") / f"slam-{self.log.stem}")
        spare_sources([folder / name for name in FILES], [str(path) for path in (self.log, self.from_map) if path])
        check_map(self.save_map, str(self.log), "slam")
        log = self._read()
        pipeline = self._pipeline(log, line)
        keys = "odometry", "seed", "rest_m", "rest_deg"
        options = LogRunConfig(noise=self._noise(line), **{key: getattr(self, key) for key in keys})
        drive = LogDrive(log, pipeline, options)
        log = self._checked(drive)
        planned = len(drive.planned())
        warm_up.prepare()
        files = LogFiles(log, planned, rerun_log(self.rerun))
        with MappingBar(log.name, planned) as bar, suppress(KeyboardInterrupt):
            for output in drive.steps():
                files.look(output, drive.rows[-1])
                bar.show(output)
        end_rerun(files.rerun, self.rerun)
        if drive.output is None and drive.ended == "interrupted":
            return INTERRUPTED
        run = drive.result()
        saved = save_map(run.pipeline, self.save_map)
        print_result(files.keep(folder, run, self._recipe(run.pipeline.config, options)), folder)
        return exit_code(self._ended(run, options), saved)

    def _ended(self, run: LogRun, options: LogRunConfig) -> int:
        """The exit code, with the reason where the result is of no use."""
        from mecp_env.evaluation.log_faults import fault_of

        fault = fault_of(run, options)
        if fault is not None:
            print_error(f"{self.log}: {fault}")
            return FAILED
        return {"interrupted": INTERRUPTED, "complete": 0}.get(run.ended, FAILED)

    def _checked(self, drive: LogDrive) -> Log:
        """The log as it is driven through, with a note where its laser and its odometry disagree."""
        from mecp_env.evaluation.log_run import REGISTERED
        from mecp_env.logs.laser_check import laser_fault

        own = self.odometry == "log" and drive.log.notes[-1:] != (REGISTERED,)
        fault = laser_fault(drive.log) if own else None
        said = () if fault is None else (f"warning: {fault}",)
        echo(*drive.log.notes[-1:] * (not own), *said)
        drive.log = replace(drive.log, notes=(*drive.log.notes, *said))
        return drive.log

    def _read(self) -> Log:
        """The log, by the options for its format; what is to be known of it is printed. Raises `LogError`."""
        from mecp_env.logs import ReadOptions, read_log

        log = read_log(
            self.log,
            ReadOptions(
                scan_topic=self.scan_topic or None,
                scan_frame=self.scan_frame,
                clock=self.clock,
                mirror=self.mirror,
                laser_yaw_deg=self.laser_yaw_deg,
                use_odometry=self.odometry != "none",
                odometry_topic=self.odometry_topic,
                max_range_m=self.max_range_m,
                field_of_view_deg=self.field_of_view_deg,
            ),
        )
        echo(*(f"note: {note}" for note in log.notes))
        return log

    def _pipeline(self, log: Log, line: Sequence[str]) -> SlamPipeline:
        """A new estimator for the log's laser, or one in a saved map. Raises `ConfigError` and `MapError`."""
        from mecp_env.evaluation.log_run import config_for
        from mecp_env.slam import SlamPipeline

        fields = named_fields(self.config, line, "--config.")
        if self.from_map is None:
            if self.start != "saved":
                raise ConfigError(f"--start: {self.start} is a place in a map; name one by --from-map")
            return SlamPipeline(config_for(log, fields))
        if fields:
            raise ConfigError(f"--config: {', '.join(fields)} given, but a map has its own configuration (--from-map)")
        return SlamPipeline.from_map(self.from_map, self._start())

    def _start(self) -> MapStart:
        """Where to begin in the map. Raises `ConfigError`."""
        if self.start == "saved":
            return "saved"
        if self.start == "unknown":
            return "unknown"
        try:
            x, y, heading = map(float, self.start.split(","))
        except ValueError:
            raise ConfigError(f"--start: {self.start!r:.60}, {POSE}") from None
        return (x, y, heading)

    def _noise(self, line: Sequence[str]) -> OdometryConfig:
        return OdometryConfig(**named_fields(self.noise, line, "--noise."))

    def _recipe(self, config: SlamConfig, options: Any) -> dict[str, Any]:
        """What another run needs to give the same."""
        start = {"from_map": str(self.from_map), "start": self.start} if self.from_map is not None else {}
        return {"log": str(self.log), **start, "run": options.model_dump(), "config": config.model_dump()}
