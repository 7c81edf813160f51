"""A file as a log: which format it has, and its sweeps and poses put in order."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from pydantic import Field

from mecp_env.core.errors import LogError, MecpError
from mecp_env.core.files import exists
from mecp_env.core.settings import Settings
from mecp_env.logs.assemble import assemble
from mecp_env.logs.bag import SUFFIXES, is_bag, read_bag
from mecp_env.logs.carmen import MAGIC, PACKED, READERS, read_carmen
from mecp_env.logs.cells import rows_of
from mecp_env.logs.clock import Clock
from mecp_env.logs.log import Log, read_archive
from mecp_env.logs.readings import Recording, Track
from mecp_env.logs.tables import TABLES, has_names, header_of, read_table

CARMEN = (".log", ".clf", ".carmen")
TEXTS = (*CARMEN, *TABLES)
FORMATS = (
    f"{', '.join(CARMEN)} (CARMEN), .csv, .tsv, .txt, .dat (BreezySLAM), these also packed as {PACKED}, .npz, .bag, "
    ".db3, .mcap or the folder of a bag"
)
ECHOED = "messages as `rostopic echo` prints them: record a bag instead (`rosbag record`, `ros2 bag record`)"
FOREIGN = {  # how files begin that are no logs as they are
    b"version https://git-lfs": "a pointer of Git LFS: `git lfs pull` fetches the file",
    b"<!doctype": "a web page",
    b"<html": "a web page",
    b"\xff\xfe": "text in UTF-16: save it as UTF-8",
    b"\xfe\xff": "text in UTF-16: save it as UTF-8",
    b"pk\x03\x04": "packed by zip: unpack it first, or save a spreadsheet as .csv",
    b"header:": ECHOED,
    b"---": ECHOED,
    b"[{": "JSON: write a table or an .npz (docs/logs.md)",
    b"{": "JSON: write a table or an .npz (docs/logs.md)",
    b"\xfd7zxz": "packed by xz: unpack it first",
    b"bzh": "packed by bzip2: unpack it first",
    b"\x28\xb5\x2f\xfd": "packed by zstd: unpack it first",
}
BINARY = {  # the first bytes of binary logs, which must have the name of their format
    b"#ROSBAG V2.0": "a bag of ROS 1 (.bag)",
    b"\x89MCAP0": "a bag of ROS 2 (.mcap)",
    b"SQLite format 3": "a database, perhaps a bag of ROS 2 (.db3)",
}
START = 2**14  # bytes of a text that tell what it is


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
    if _is_carmen(path, suffix):
        _check_options(options, "scan_frame", "odometry_topic")
        return read_carmen(path, _only(options.scan_topics), options.field_of_view_deg)
    _check_options(options, "scan_topic", "scan_frame", "odometry_topic")
    return read_archive(path) if suffix == ".npz" else read_table(path, options.field_of_view_deg)


def _check_file(path: Path, suffix: str) -> None:
    """Raise `LogError` for what is no log by its name or by its first bytes."""
    if not exists(path):
        raise LogError("no such file")
    if path.is_dir():
        if not is_bag(path):
            raise LogError("a folder without a bag; name a file")
        return
    if not path.is_file():
        raise LogError("no plain file, but a pipe or a device: save it as a file first")
    if not path.stat().st_size:
        raise LogError("an empty file")
    _check_start(path, suffix)
    if not is_bag(path):
        _check_name(path, suffix)


def _check_name(path: Path, suffix: str) -> None:
    """Raise `LogError` for the name of a file that is not read so."""
    if suffix in SUFFIXES:
        raise LogError(f"a bag is read as it is, with {suffix} behind its name: unpack or rename it")
    if suffix not in (".npz", *TEXTS):
        raise LogError(f"unknown format {path.suffix!r:.20}, expected {FORMATS}")


def _check_start(path: Path, suffix: str) -> None:
    """Raise `LogError` for a file that begins as another format."""
    start = _start(path)
    foreign = _named(FOREIGN, start.lstrip().lower())
    if foreign and suffix != ".npz":
        raise LogError(f"not a log as it is, but {foreign}")
    _check_kind(path, suffix, start)


def _check_kind(path: Path, suffix: str, start: bytes) -> None:
    """Raise `LogError` for a file that begins as no text, or as no bag, where its name says so."""
    binary = _named(BINARY, start)
    if binary and suffix not in binary:
        raise LogError(f"not what its name says, but {binary}: rename it")
    if is_bag(path) and not binary:
        raise LogError("no bag, or damaged: it begins as none does")
    if suffix in TEXTS and b"\0" in start and not start.startswith(MAGIC):
        raise LogError("no text as its name says, or text in UTF-16: save it as UTF-8")


def _named(marks: dict[bytes, str], start: bytes) -> str:
    """What a file is that starts so; empty where no mark fits."""
    return next((what for mark, what in marks.items() if start.startswith(mark)), "")


def _start(path: Path) -> bytes:
    """The first bytes of a file; none where it cannot be read: its reader says what is wrong."""
    with suppress(OSError), path.open("rb") as file:
        return file.read(START)
    return b""


def _is_carmen(path: Path, suffix: str) -> bool:
    """True where a text is a CARMEN log by its first lines, or by its name unless those are names of columns."""
    start = _start(path)
    if suffix not in TEXTS or start.startswith(MAGIC):
        return suffix in CARMEN
    words = [line.split(maxsplit=2)[:2] for line in start.decode("utf-8-sig", "replace").splitlines()]
    if any(len(line) > 1 and line[0] in READERS for line in words):
        return True
    return suffix in CARMEN and not has_names(header_of(list(rows_of(start, comments=True))))


def _check_options(options: ReadOptions, *of_bags: str) -> None:
    """Raise `LogError` where one of the options of bags is given with another format."""
    for name in of_bags:
        given = options.scan_topics if name == "scan_topic" else getattr(options, name)
        if given:
            said = given if isinstance(given, str) else ", ".join(given)
            raise LogError(f"--{name.replace('_', '-')}: {said!r:.80} given, but this is no bag")


def _only(topics: tuple[str, ...]) -> str | None:
    """The laser message of a CARMEN log. Raises `LogError` for several."""
    if len(topics) > 1:
        raise LogError(f"--scan-topic: {', '.join(topics)}: a CARMEN log has one laser message; several are for bags")
    return topics[0] if topics else None
