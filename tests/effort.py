"""The cost of a workload, measured so that a busy or slow machine does not change the verdict.

Bounds in seconds are stated for a quiet machine. Here they are checked in processor time, by a yardstick: a fixed piece
of work timed beside, against what it takes on that machine. Memory is the peak of this process while it works.
"""

import re
import resource
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely

YARDSTICK_S = 0.025  # of the yardstick on a quiet machine of 2.6 GHz; in bad moments the same machine takes 0.04
TRIES = 3
STATUS, FORGET_PEAK = Path("/proc/self/status"), Path("/proc/self/clear_refs")


@dataclass(frozen=True, slots=True)
class Cost:
    """The cost of a workload."""

    seconds: float  # of processor time, as on a quiet machine
    megabytes: float  # peak memory above the memory in use before


def cost(work: Callable[[], object], enough_s: float) -> Cost:
    """The cost of `work()`: the fastest of up to three tries; a try below `enough_s` ends the measurement."""
    _forget_peak()
    before = _memory_mb("VmRSS")
    seconds = _timed(work)
    megabytes = _memory_mb("VmHWM") - before
    for _ in range(TRIES - 1):
        if seconds >= enough_s:
            slow = slowness()
            seconds = min(seconds, _timed(work) / max(slow, slowness()))
    return Cost(seconds, megabytes)


def slowness() -> float:
    """The slowdown of this machine relative to a quiet one; at least 1."""
    return max(1.0, _timed(_yardstick) / YARDSTICK_S)


def _forget_peak() -> None:
    """Reset the memory peak. The peak of `getrusage` cannot be reset, and a new process inherits its parent's."""
    with suppress(OSError):  # another system; a container that forbids it, where memory then only seems more
        FORGET_PEAK.write_text("5")


def _memory_mb(field: str) -> float:
    if not STATUS.exists():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    found = re.search(rf"{field}:\s+(\d+) kB", STATUS.read_text())
    assert found is not None
    return int(found[1]) / 1024


def _timed(work: Callable[[], object]) -> float:
    begun = time.thread_time()
    work()
    return time.thread_time() - begun


def _yardstick() -> None:
    """Work of the kinds that reading a file is made of: objects, small arrays, geometry."""
    rings = [np.roll(np.array([(x, 0.0), (x + 0.5, 0.0), (x, 1.0)]), 1, axis=0) for x in range(400)]
    shapely.union_all([shapely.Polygon(ring) for ring in rings])
