"""Compile kernels on the other cores while the first start compiles them on this one.

numba compiles on one core, and the environment has some three hundred kernels. So the process that finds the cache
empty starts helpers: each takes the kernels that are needed last first, from a list of what an exploration calls, and
puts them into the cache, where this process finds them when it gets there. The list is only that, a list: what is not
in it, or no longer fits, is compiled when it is called. `python -m mecp_env.cli.record_signatures` writes it anew.

MECP_ENV_COMPILE_HELPERS sets how many helpers there may be; 0 switches them off.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib
import json
import multiprocessing
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba import types

LIST = Path(__file__).with_name("signatures.json")
SWITCH = "MECP_ENV_COMPILE_HELPERS"
MOST_HELPERS = 3
NOTHING = subprocess.DEVNULL
STALE_S = 600.0  # a lock older than this was left by a process that was killed

Entry = list[Any]  # module, name, encoded argument types


def start_helpers(directory: Path) -> None:
    """Start helpers for the cache in `directory`, unless others are at work there already."""
    count = helpers_wanted()
    lock = directory / "helpers.lock"
    if not count or not LIST.is_file() or not _take(lock):
        return
    path = os.pathsep.join([str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {SWITCH: "0", "PYTHONPATH": path}
    for share in range(count):
        line = [sys.executable, "-m", "mecp_env.core.warm_up", str(share), str(count)]
        with contextlib.suppress(OSError):
            helper = subprocess.Popen(line, env=environment, stdin=NOTHING, stdout=NOTHING, stderr=NOTHING)
            atexit.register(helper.terminate)
    atexit.register(lock.unlink, missing_ok=True)


def helpers_wanted() -> int:
    """How many helpers this process may start: one a further core, none in a worker of somebody's pool."""
    if multiprocessing.parent_process() is not None:
        return 0
    allowed = os.environ.get(SWITCH, str(MOST_HELPERS))
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(0, min(cores - 1, int(allowed) if allowed.isdigit() else 0))


def compile_share(entries: list[Entry], share: int, count: int) -> None:
    """Compile every `count`-th kernel of the list, those that are needed last first; stops with the parent process."""
    parent = os.getppid()
    for module, name, arguments in entries[::-1][share::count]:
        if os.getppid() != parent:
            return
        with contextlib.suppress(Exception):  # a kernel of that name and those arguments may be gone
            function = getattr(importlib.import_module(module), name)
            function.compile(tuple(decode(argument) for argument in arguments))


def encode(argument: types.Type) -> Any:
    """An argument's type as plain data. Raises `ValueError` for kinds that no kernel takes."""
    if isinstance(argument, types.Array):
        return ["array", str(argument.dtype), argument.ndim, argument.layout, argument.mutable]
    if isinstance(argument, types.BaseNamedTuple):
        kind = argument.instance_class
        return ["named", kind.__module__, kind.__qualname__, [encode(part) for part in argument.types]]
    if isinstance(argument, types.BaseTuple):
        return ["tuple", [encode(part) for part in argument.types]]
    if isinstance(argument, types.Number | types.Boolean):
        return str(argument)
    raise ValueError(f"no kernel takes {argument}")


def decode(data: Any) -> types.Type:
    """The type that `encode` made `data` of."""
    if isinstance(data, str):
        return numba.from_dtype(np.dtype(data))
    kind, *parts = data
    if kind == "array":
        dtype, ndim, layout, mutable = parts
        return types.Array(decode(dtype), ndim, layout, readonly=not mutable)
    if kind == "named":
        module, name, inner = parts
        return types.NamedTuple([decode(part) for part in inner], getattr(importlib.import_module(module), name))
    return types.Tuple([decode(part) for part in parts[0]])


def _take(lock: Path) -> bool:
    """True when the lock was free, or left behind."""
    with contextlib.suppress(OSError):
        if time.time() - lock.stat().st_mtime > STALE_S:
            lock.unlink()
    try:
        os.close(os.open(lock, os.O_CREAT | os.O_EXCL))
    except OSError:
        return False
    return True


if __name__ == "__main__":
    compile_share(json.loads(LIST.read_text()), int(sys.argv[1]), int(sys.argv[2]))
