"""Units of work on a Ray cluster that is already running (extra `cluster`); this process starts none.

Each unit takes one CPU of the cluster. Its result is that of a process here, bit for bit, on machines of one kind: a
node whose code, libraries or kind of machine differ refuses the work.
"""

from __future__ import annotations

import os
import re
import socket
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, partial
from itertools import islice
from pathlib import Path
from typing import Any

from mecp_env.core.errors import ConfigError
from mecp_env.core.processes import FailedUnit, Failure, WorkerDied
from mecp_env.core.provenance import checksums, dependencies, import_modules, imported_modules

ADDRESS = re.compile(r"([\w.-]{1,253}):(\d{1,5})", re.ASCII)
CONNECT_S = 5.0  # until a machine that does not answer has no cluster
ONE_TRY = "RAY_NUM_REDIS_GET_RETRIES", "1"  # of 40 s each to reach the head, for a cluster that runs already


def run_on_cluster(
    task: Callable[[Any], Any], units: Iterable[Any], address: str
) -> Generator[tuple[int, Any | FailedUnit]]:
    """`task(unit)` of each unit as it is finished, with its number: as `run_units`, on the cluster at HOST:PORT.

    This machine must be a node of the cluster, and every node must have this code at the same path. Units that still
    run when the generator is closed are cancelled. Raises `ConfigError` for a wrong address, and without Ray.
    """
    with connected(address) as ray:
        work = ray.remote(num_cpus=1, max_retries=0)(attempt).remote
        code, numbered, busy = code_of(task), enumerate(units), dict[Any, tuple[int, Any]]()
        at_once = 2 * max(int(ray.cluster_resources().get("CPU", 1)), 1)  # so that no CPU waits for its next unit
        try:
            while True:
                for number, unit in islice(numbered, at_once - len(busy)):
                    busy[work(task, unit, code, imported_modules())] = number, unit
                if not busy:
                    return
                for reference in ray.wait(list(busy))[0]:
                    number, unit = busy.pop(reference)
                    yield number, _result(ray, reference, unit)
        finally:
            for reference in busy:
                ray.cancel(reference, force=True)


@contextmanager
def connected(address: str) -> Iterator[Any]:
    """Ray, connected to the cluster at HOST:PORT. Raises `ConfigError`."""
    found = ADDRESS.fullmatch(address)
    if not found or not 1 <= int(found[2]) <= 65535:
        raise ConfigError(f"cluster: {address!r:.80}, expected HOST:PORT, such as 10.0.0.1:6379: the head of Ray")
    os.environ.setdefault(*ONE_TRY)
    try:
        import ray
    except ImportError:
        raise ConfigError("cluster: Ray is not installed; the extra `cluster` has it") from None
    try:
        socket.create_connection((found[1], int(found[2])), CONNECT_S).close()
        ray.init(address=address, log_to_driver=False, logging_level="ERROR")
    except (OSError, RuntimeError, ValueError) as error:
        raise ConfigError(f"cluster: no Ray cluster at {address} ({' '.join(str(error).split()):.120})") from None
    try:
        yield ray
    finally:
        ray.shutdown()


def attempt(task: Callable[[Any], Any], unit: Any, code: dict[str, str], modules: Sequence[str] = ()) -> Any:
    """The result of a unit on a node of the cluster, or a `FailedUnit`; `modules` register custom parts of the user."""
    try:
        import_modules(modules)
        here = code_of(task)
        other = ", ".join(f"{name} {here[name]}, not {code.get(name)}" for name in here if here[name] != code.get(name))
        if other:
            raise ConfigError(f"cluster: a node has {other}")
        return task(unit)
    except Exception as error:
        failure = Failure.of(error)
        return FailedUnit(unit, failure.reason, failure.error)


def code_of(task: Callable[[Any], Any]) -> dict[str, str]:
    """What the results of a task depend on beside its unit; of a partial function, that of the function."""
    function = task.func if isinstance(task, partial) else task
    return _dependencies(Path(str(sys.modules[function.__module__].__file__)).parent) | checksums()


@cache
def _dependencies(folder: Path) -> dict[str, str]:
    return dependencies(folder)


def _result(ray: Any, reference: Any, unit: Any) -> Any:
    """What `attempt` returned; a `FailedUnit`, too, where its process or node ended."""
    try:
        return ray.get(reference)
    except ray.exceptions.RayError as error:
        reason = f"{error!s:.400}".strip().splitlines()[0]
        return FailedUnit(unit, reason, WorkerDied(reason))
