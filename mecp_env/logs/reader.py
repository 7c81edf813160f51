"""A file as a log: which format it has, and its sweeps and poses put in order."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from pydantic import Field

from mecp_env.core.errors import LogError, MecpError
from mecp_env.core.files import exists
from mecp_env.core.settings import Settings
from mecp_env.logs.assemble import assemble
from mecp_env.logs.bag import is_bag, read_bag
from mecp_env.logs.carmen import PACKED, read_carmen
from mecp_env.logs.clock import Clock
from mecp_env.logs.log import Log, read_archive
from mecp_env.logs.readings import Recording, Track
from mecp_env.logs.tables import TABLES, read_table

CARMEN = (".log", ".clf", ".carmen")
FORMATS = (
    f"{', '.join(CARMEN)} (CARMEN), .csv, .tsv, .dat (BreezySLAM), these also packed as {PACKED}, .npz, .bag, .db3, "
    ".mcap or the folder of a bag"
)
FOREIGN = {  # how files begin that are no logs as they are
    b"version https://git-lfs": "a pointer of Git LFS: `git lfs pull` fetches the file",
    b"<!doctype": "a web page",
    b"<html": "a web page",
    b"\xff\xfe": "text in UTF-16: save it as UTF-8",
    b"\xfe\xff": "text in UTF-16: save it as UTF-8",
    b"pk\x03\x04": "packed by zip: unpack it first",
    b"\xfd7zxz": "packed by xz: unpack it first",
    b"bzh": "packed by bzip2: unpack it first",
    b"\x28\xb5\x2f\xfd": "packed by zstd: unpack it first",
}


class ReadOptions(Settings):
    """What a log does not say, or says wrongly."""

    scan_topic: str | tuple[str, ...] | None = None  # of a bag, several for several lasers that are merged; or the
    # laser message of a CARMEN log; None: the only one
    scan_frame: str | None = None  # of a bag whose scans have several frames: the one to read; None: all, merged
    odometry_topic: str | None = None  # of a bag; None: the only one
    max_range_m: float | None = Field(None, gt=0.0, le=1000.0)  # readings from here on are no return; None: by the log
    field_of_view_deg: float | None = Field(None, ge=10.0, le=360.0)  # beams outside are left out; FLASER lines have
    # no angles: their beams are spread over it
    mirror: bool = False  # the laser turns clockwise, or hangs upside down
    laser_yaw_deg: float = Field(0.0, ge=-180.0, le=180.0)  # added to the heading of the laser on the robot
    clock: Clock = "message"  # or received: the order of the file, in a bag the times when messages were received
    use_odometry: bool = True  # False: that of the log is left out

    @property
    def scan_topics(self) -> tuple[str, ...]:
        """All topics that are asked for."""
        return (self.scan_topic,) if isinstance(self.scan_topic, str) else self.scan_topic or ()


def read_log(path: str | Path, options: ReadOptions | None = None) -> Log:
    """The log in a file or folder. What is skipped or repaired is counted. Raises `LogError` that names the file."""
    options, path = options or ReadOptions(), Path(path)
    try:
        recording = _asked(_recording(path, options), options)
        limits = options.max_range_m, options.field_of_view_deg
        return assemble(recording, *limits, options.clock, options.laser_yaw_deg, options.use_odometry)
    except MecpError as error:
        raise LogError(f"{path}: {error}") from None


def _asked(recording: Recording, options: ReadOptions) -> Recording:
    """A recording with what the options say in place of what the file does."""
    if options.mirror:
        recording.sweeps = [sweep.mirrored() for sweep in recording.sweeps]
    if not options.use_odometry:
        recording.odometry = Track()
    return recording


def _recording(path: Path, options: ReadOptions) -> Recording:
    """What is in a file, by the reader of its format."""
    suffix = Path(path.name.lower().removesuffix(PACKED)).suffix
    _check_file(path, suffix)
    if is_bag(path):
        asked = (options.odometry_topic,) if options.odometry_topic else ()
        return read_bag(path, options.scan_topics, asked, options.scan_frame, several=not options.use_odometry)
    if suffix in CARMEN:
        _check_options(options, "scan_frame", "odometry_topic")
        return read_carmen(path, _only(options.scan_topics), options.field_of_view_deg)
    _check_options(options, "scan_topic", "scan_frame", "odometry_topic")
    return read_archive(path) if suffix == ".npz" else read_table(path, options.field_of_view_deg)


def _check_file(path: Path, suffix: str) -> None:
    """Raise `LogError` for what is no log by its name or by its first bytes."""
    if not exists(path):
        raise LogError("no such file")
    if path.is_file() and suffix != ".npz":
        _check_start(path)
    if is_bag(path):
        return
    if path.is_dir():
        raise LogError("a folder without a bag; name a file")
    if suffix not in (".npz", *TABLES, *CARMEN):
        raise LogError(f"unknown format {path.suffix!r:.20}, expected {FORMATS}")


def _check_start(path: Path) -> None:
    """Raise `LogError` for a file that begins as another format."""
    start = b""
    with suppress(OSError), path.open("rb") as file:  # its reader says what is wrong
        start = file.read(32).lstrip().lower()
    for mark, what in FOREIGN.items():
        if start.startswith(mark):
            raise LogError(f"not a log as it is, but {what}")


def _check_options(options: ReadOptions, *of_bags: str) -> None:
    """Raise `LogError` where one of the options of bags is given with another format."""
    for name in of_bags:
        if getattr(options, name) is not None:
            raise LogError(f"--{name.replace('_', '-')}: {getattr(options, name)!r:.80} given, but this is no bag")


def _only(topics: tuple[str, ...]) -> str | None:
    """The laser message of a CARMEN log. Raises `LogError` for several."""
    if len(topics) > 1:
        raise LogError(f"--scan-topic: {', '.join(topics)}: a CARMEN log has one laser message; several are for bags")
    return topics[0] if topics else None
