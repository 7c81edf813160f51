"""Compile ahead what an episode calls: on first use, and for more than episodes by `mecp-env warmup`."""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numba

from mecp_env.core import jit

log = logging.getLogger(__name__)

SWITCH = "MECP_ENV_WARM_UP"  # 0: the first use compiles each function when it is called
DRIVES = "mecp_env.cli.warmup"  # a process each; not by `multiprocessing`, which imports the user's script again
FIRST, LATER = ("episode",), ("log", "tasks")  # those of `LATER` at the same time
DONE = "warm"  # file in the cache
PERIOD_S = 0.5  # of reports


def prepare() -> None:
    """On first use: compile what an episode calls, say so in one line, and wait for it; never in a worker of a pool."""
    if os.environ.get(SWITCH) != "0" and multiprocessing.parent_process() is None and is_cold():
        log.warning("mecp_env: compiling functions; once, for a minute or two (%s=0 switches it off)", SWITCH)
        if compile_ahead(FIRST, show):
            log.warning("mecp_env: compiling ahead failed: functions are compiled when they are called")


def is_cold() -> bool:
    """True where nothing has been compiled ahead, although there is a place for it."""
    place = jit.cache_directory()
    return not numba.config.DISABLE_JIT and jit.usable(place) and not (place / DONE).exists()


def sizes_in(place: Path) -> list[int]:
    """The bytes of each compiled function in a cache, where other processes write and remove folders meanwhile."""
    sizes = list[int]()
    for folder, _, names in os.walk(place):
        for name in names:
            with contextlib.suppress(OSError):
                sizes += [Path(folder, name).stat().st_size] * name.endswith(".nbc")
    return sizes


def show(count: int) -> None:
    """How many functions are compiled, on stderr, where that is a terminal."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\r{count} functions")
        sys.stderr.flush()


def compile_ahead(drives: Sequence[str], report: Callable[[int], None]) -> tuple[str, ...]:
    """Run the drives at the same time, and report how many functions are compiled; whatever happens, none runs on.

    Returns those that failed.
    """
    place, path = jit.cache_directory(), [str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")]
    env = os.environ | {SWITCH: "0", "PYTHONPATH": os.pathsep.join(path)}
    silent: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    helpers = [subprocess.Popen([sys.executable, "-m", DRIVES, name], env=env, **silent) for name in drives]
    try:
        while any(helper.poll() is None for helper in helpers):
            report(len(sizes_in(place)))
            time.sleep(PERIOD_S)
    finally:
        for helper in helpers:
            helper.terminate()
            helper.wait()
    with contextlib.suppress(OSError):
        (place / DONE).touch()
    return tuple(name for name, helper in zip(drives, helpers, strict=True) if helper.returncode)
