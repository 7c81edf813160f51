"""A file as a log: which format it has, and its sweeps and poses put in order."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from mecp_env.core.errors import LogError, MecpError
from mecp_env.core.files import exists
from mecp_env.logs.assemble import assemble
from mecp_env.logs.bag import SUFFIXES, is_bag, read_bag
from mecp_env.logs.carmen import MAGIC, PACKED, READERS, read_carmen
from mecp_env.logs.columns import rows_of
from mecp_env.logs.log import Log, read_archive
from mecp_env.logs.recording import ReadOptions, Recording
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


def read_log(path: str | Path, options: ReadOptions | None = None) -> Log:
    """The log in a file or folder. What is skipped or repaired is counted. Raises `LogError` that names the file."""
    options, path = options or ReadOptions(), Path(path)
    try:
        return assemble(_recording(path, options), options)
    except MecpError as error:
        raise LogError(f"{path}: {error}") from None


def _recording(path: Path, options: ReadOptions) -> Recording:
    """What is in a file, by the reader of its format. Raises `LogError`."""
    suffix = Path(path.name.lower().removesuffix(PACKED)).suffix
    _check_file(path)
    start = _start(path)
    _check_start(path, suffix, start)
    if is_bag(path):
        return read_bag(path, options)
    _check_name(path, suffix, start)
    is_carmen = suffix in TEXTS and _is_carmen(start, suffix)
    _check_options(options, is_carmen)
    if is_carmen:
        return read_carmen(path, next(iter(options.scan_topics), None), options.field_of_view_deg)
    return read_archive(path) if suffix == ".npz" else read_table(path, options.field_of_view_deg)


def _check_file(path: Path) -> None:
    """Raise `LogError` for what cannot be a log."""
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


def _start(path: Path) -> bytes:
    """The first bytes of a file; none of a folder, or where it cannot be read: its reader says what is wrong."""
    with suppress(OSError), path.open("rb") as file:
        return file.read(START)
    return b""


def _check_start(path: Path, suffix: str, start: bytes) -> None:
    """Raise `LogError` for a file that begins as another format than its name says."""
    foreign, binary = _named(FOREIGN, start.lstrip().lower()), _named(BINARY, start)
    if foreign and suffix != ".npz":
        raise LogError(f"not a log as it is, but {foreign}")
    if binary and suffix not in binary:
        raise LogError(f"not what its name says, but {binary}: rename it")
    if path.is_file() and is_bag(path) and not binary:
        raise LogError("no bag, or damaged: it begins as none does")


def _check_name(path: Path, suffix: str, start: bytes) -> None:
    """Raise `LogError` for the name of a file that is not read so."""
    if suffix in SUFFIXES:
        raise LogError(f"a bag is read as it is, with {suffix} behind its name: unpack or rename it")
    if suffix not in (".npz", *TEXTS):
        raise LogError(f"unknown format {path.suffix!r:.20}, expected {FORMATS}")
    if suffix in TEXTS and b"\0" in start and not start.startswith(MAGIC):
        raise LogError("no text as its name says, or text in UTF-16: save it as UTF-8")


def _named(marks: dict[bytes, str], start: bytes) -> str:
    """What a file is that starts so; empty where no mark fits."""
    return next((what for mark, what in marks.items() if start.startswith(mark)), "")


def _is_carmen(start: bytes, suffix: str) -> bool:
    """True where a text is a CARMEN log by its first lines, or by its name unless those are names of columns."""
    if start.startswith(MAGIC):
        return suffix in CARMEN
    words = [line.split(maxsplit=2)[:2] for line in start.decode("utf-8-sig", "replace").splitlines()]
    if any(len(line) > 1 and line[0] in READERS for line in words):
        return True
    return suffix in CARMEN and not has_names(header_of(list(rows_of(start, comments=True))))


def _check_options(options: ReadOptions, is_carmen: bool) -> None:
    """Raise `LogError` where one of the options of bags is given with another format."""
    topics = options.scan_topics
    given = {"scan-frame": options.scan_frame, "odometry-topic": options.odometry_topic}
    for name, said in {"scan-topic": "" if is_carmen else ", ".join(topics), **given}.items():
        if said:
            raise LogError(f"--{name}: {said!r:.80} given, but this is no bag")
    if is_carmen and len(topics) > 1:
        raise LogError(f"--scan-topic: {', '.join(topics)}: a CARMEN log has one laser message; several are for bags")
