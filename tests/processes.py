"""Processes: what one prints, what a file costs it, whether others run still. Imports little, as many import it."""

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import pytest

needs_linux = pytest.mark.skipif(not Path("/proc/self/smaps_rollup").exists(), reason="reads /proc")


def run_python(code: str, **environment: str) -> str:
    """What `python -c CODE` prints, which has the root of the clone to import from."""
    variables = os.environ | {"PYTHONPATH": str(Path(__file__).parent.parent)} | environment
    done = subprocess.run([sys.executable, "-c", code], env=variables, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr[-3000:]
    return done.stdout


MEASURE = """
import os, time, warnings
from pathlib import Path
def memory_mb(field):
    return int(Path("/proc/self/status").read_text().partition(field + ":")[2].split()[0]) / 1024
warnings.simplefilter("ignore")
READ
for path in map(Path, PATHS):
    if child := os.fork():  # what a file left behind is not counted for the next one
        assert os.waitpid(child, 0)[1] == 0
        continue
    Path("/proc/self/clear_refs").write_text("5")  # forget the peak
    before, start = memory_mb("VmRSS"), time.process_time()
    try:
        said = type(read(path)).__name__
    except ValueError as error:
        said = "/".join(kind.__name__ for kind in type(error).__mro__)
    peak = memory_mb("VmHWM")
    print(path, peak, peak - before, time.process_time() - start, said, sep=";", flush=True)
    os._exit(0)
"""


class Cost(NamedTuple):
    """What reading a file takes, and the type of the result or of the error with its bases."""

    path: str
    peak_mb: float  # of the whole process
    growth_mb: float
    seconds: float  # of processor time
    said: str


def costs(read: str, paths: list[Path]) -> list[Cost]:
    """The cost of each file, in a process of its own each, by code that defines `read`."""
    printed = run_python(MEASURE.replace("READ", read).replace("PATHS", repr([str(path) for path in paths])))
    rows = [line.split(";") for line in printed.splitlines()]
    return [Cost(path, float(peak), float(growth), float(s), said) for path, peak, growth, s, said in rows]


def alive(pid: int) -> bool:
    """Whether a process is running; a zombie is not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def gone_within(pids: list[int], seconds: float) -> bool:
    """Whether none of these processes is running after at most this time."""
    end = time.monotonic() + seconds
    while any(alive(pid) for pid in pids) and time.monotonic() < end:
        time.sleep(0.02)
    return not any(alive(pid) for pid in pids)
