"""Processes: what one prints, whether others run still. Imports little, as many processes import it."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

needs_linux = pytest.mark.skipif(not Path("/proc/self/smaps_rollup").exists(), reason="reads /proc")


def run_python(code: str, **environment: str) -> str:
    """What `python -c CODE` prints, which has the root of the clone to import from."""
    variables = os.environ | {"PYTHONPATH": str(Path(__file__).parent.parent)} | environment
    done = subprocess.run([sys.executable, "-c", code], env=variables, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr[-3000:]
    return done.stdout


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
