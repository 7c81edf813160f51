"""Freed memory is returned to the system where the C library can."""

from __future__ import annotations

import ctypes
import platform
from typing import NoReturn

import pytest

from benchmarks.process_use import memory_mb
from mecp_env.core import heap


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library keeps freed memory in its own way")
def test_freed_memory_between_blocks_in_use_is_returned() -> None:
    blocks = [bytes(2_000) for _ in range(20_000)]
    kept = blocks[::1_000]
    del blocks
    before = memory_mb(["self"])
    heap.trim()
    assert memory_mb(["self"]) < before - 20.0
    assert len(kept) == 20


def test_another_c_library_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str | None) -> NoReturn:
        raise OSError("no such library")

    monkeypatch.setattr(ctypes, "CDLL", missing)
    heap._malloc_trim.cache_clear()
    heap.trim()
    heap._malloc_trim.cache_clear()
