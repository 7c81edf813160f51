"""A file as a log: which format it has, and its sweeps and poses put in order."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from mecp_env.core.errors import LogError, MecpError
from mecp_env.core.paths import exists
from mecp_env.core.settings import Settings
from mecp_env.logs.archive import read_archive
from mecp_env.logs.assemble import assemble
from mecp_env.logs.bag import is_bag, read_bag
from mecp_env.logs.carmen import PACKED, read_carmen
from mecp_env.logs.log import Log
from mecp_env.logs.recording import Recording

CARMEN = (".log", ".clf", ".carmen")
FORMATS = f"{', '.join(CARMEN)} (CARMEN, also packed as {PACKED}), .npz, .bag, .db3, .mcap or the folder of a ROS 2 bag"


class ReadOptions(Settings):
    """What a log does not say, or says wrongly."""

    scan_topic: str | None = None  # of a bag, or the laser message of a CARMEN log; None: the only one
    odometry_topic: str | None = None  # of a bag; None: the only one
    max_range_m: float | None = Field(None, gt=0.0, le=1000.0)  # readings from here on are no return; None: by the log
    field_of_view_deg: float | None = Field(None, ge=10.0, le=360.0)  # beams outside are left out; FLASER lines have
    # no angles: their beams are spread over it


def read_log(path: str | Path, options: ReadOptions | None = None) -> Log:
    """The log in a file or folder. What is skipped or repaired is counted. Raises `LogError` that names the file."""
    options, path = options or ReadOptions(), Path(path)
    try:
        return assemble(_recording(path, options), options.max_range_m, options.field_of_view_deg)
    except MecpError as error:
        raise LogError(f"{path}: {error}") from None


def _recording(path: Path, options: ReadOptions) -> Recording:
    """What is in a file, by the reader of its format."""
    if not exists(path):
        raise LogError("no such file")
    if is_bag(path):
        return read_bag(path, options.scan_topic, options.odometry_topic)
    if path.is_dir():
        raise LogError("a folder without metadata.yaml, so no ROS 2 bag; name a file")
    if path.suffix == ".npz":
        return read_archive(path)
    if Path(path.name.removesuffix(PACKED)).suffix in CARMEN:
        return read_carmen(path, options.scan_topic, options.field_of_view_deg)
    raise LogError(f"unknown format {path.suffix!r:.20}, expected {FORMATS}")
