"""Freed memory is returned to the system where the C library can."""

import ctypes
import platform
import runpy

import pytest

from benchmarks.process_use import memory_mb
from mecp_env.core import processes
from tests.processes import run_python

GLIBC = pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library keeps memory in its own way")
AGAIN = """
import resource, numpy, mecp_env.core.processes
mecp_env.core.processes.keep()
def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    arrays = [numpy.ones(size << 17) for size in (9, 17, 31)]  # MB
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
print(faults(), faults())
"""


@GLIBC
def test_freed_memory_between_blocks_in_use_is_returned() -> None:
    blocks = [bytes(2_000) for _ in range(20_000)]
    kept = blocks[::1_000]
    del blocks
    before = memory_mb(["self"])
    processes.trim()
    assert memory_mb(["self"]) < before - 20.0
    assert len(kept) == 20


@GLIBC
def test_large_arrays_are_kept_for_later_where_that_is_asked_for() -> None:
    first, again = map(int, run_python(AGAIN).split())
    assert first > 10 * again


def test_another_c_library_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ctypes, "CDLL", lambda name: object())  # without these functions
    fresh = runpy.run_path(str(processes.__file__))  # which has not looked for the functions yet
    fresh["trim"]()
    fresh["keep"]()
