"""The cost of reading untrusted plans, in a separate process that measures its memory."""

import time
from collections.abc import Sequence
from pathlib import Path

from mecp_env.core.errors import LayoutError
from mecp_env.floorplans import load_plan
from tests.processes import run_python

SECONDS, MEGABYTES = 6.0, 200  # as docs/plans.md promises, with twice the time for a busy machine

Row = tuple[float, float, bool, str]  # seconds, megabytes, refused, path


def costs(sound: Path, paths: Sequence[Path]) -> list[Row]:
    """The cost of each file, in a process that has read a valid one before."""
    names = [str(path) for path in (sound, *paths)]
    printed = run_python(f"from tests.floorplans.untrusted import main; main(*{names!r})")
    rows = [line.split(";") for line in printed.splitlines()]
    return [(float(s), float(mb), refused == "True", name) for s, mb, refused, name in rows]


def main(sound: str, *names: str) -> None:
    """Print one row per file."""
    load_plan(sound)
    for name in names:
        Path("/proc/self/clear_refs").write_text("5")  # forget the peak
        before, start = memory_mb("VmRSS"), time.process_time()
        refused = is_refused(name)
        print(time.process_time() - start, memory_mb("VmHWM") - before, refused, name, sep=";")


def is_refused(name: str) -> bool:
    try:
        load_plan(name, resolution_m=0.05)
    except LayoutError:
        return True
    return False


def memory_mb(field: str) -> float:
    """A field of this process in /proc."""
    return int(Path("/proc/self/status").read_text().partition(f"{field}:")[2].split()[0]) / 1024
