"""Units of work on several processes or a Ray cluster; results kept in a folder, to resume and to divide the work.

Each unit has a file with its result as JSON, whose numbers are exact, and the run that it belongs to. Every result
passes through its file, so that a resumed or divided run gives the same as a single one, bit for bit.

Each unit takes one CPU of the cluster. Its result is that of a process here, bit for bit, on machines of one kind: a
node whose code, libraries or kind of machine differ refuses the work.
"""

from __future__ import annotations

import json
import os
import re
import socket
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, fields, is_dataclass
from functools import partial
from itertools import islice
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np
from pydantic import TypeAdapter

from mecp_env.core.errors import ConfigError
from mecp_env.core.files import write_atomic
from mecp_env.core.processes import Failure, Worker, WorkerDied
from mecp_env.core.provenance import checksum, checksums, dependencies, import_modules, imported_modules

ADDRESS = re.compile(r"([\w.-]{1,253}):(\d{1,5})", re.ASCII)
CONNECT_S = 5.0  # until a machine that does not answer has no cluster
ONE_TRY = "RAY_NUM_REDIS_GET_RETRIES", "1"  # of 40 s each to reach the head, for a cluster that runs already
Unit = TypeVar("Unit")
Result = TypeVar("Result")
Busy = dict[Worker, tuple[int, Any]]  # the numbered units of workers
START = "spawn"  # a forked process would have the threads and the state of the libraries of this one
POLL_S = 0.2  # how long results are waited for, before Python can see an interrupt
FORMAT, VERSION = "mecp_env result", 1
NOT_A_NAME = re.compile(r"[^\w-]+", re.ASCII)


@dataclass(frozen=True, slots=True)
class FailedUnit:
    """A unit of work without a result, and the reason."""

    unit: Any
    reason: str
    error: Exception  # `WorkerDied` when its process ended

    def __str__(self) -> str:
        return f"{self.unit}: {self.reason}"


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


def attempt(
    task: Callable[[Unit], Result], unit: Unit, code: Mapping[str, str] | None = None, modules: Sequence[str] = ()
) -> Result | FailedUnit:
    """The result of a unit in this process.

    On a node of a cluster, `code` is that of the machine that asks, and `modules` register custom parts of the user.
    """
    try:
        import_modules(modules)
        asked = {} if code is None else code
        here = code_of(task) if asked else {}
        other = [f"{name} {found}, not {asked.get(name)}" for name, found in here.items() if found != asked.get(name)]
        if other:
            raise ConfigError(f"cluster: a node has {', '.join(other)}")
        return task(unit)
    except Exception as error:
        return FailedUnit(unit, Failure.of(error).reason, error)


def code_of(task: Callable[[Any], Any]) -> dict[str, str]:
    """What the results of a task depend on beside its unit; of a partial function, that of the function."""
    function = task.func if isinstance(task, partial) else task
    return dependencies(Path(str(sys.modules[function.__module__].__file__)).parent) | checksums()


def _result(ray: Any, reference: Any, unit: Any) -> Any:
    """What `attempt` returned; a `FailedUnit`, too, where its process or node ended."""
    try:
        return ray.get(reference)
    except ray.exceptions.RayError as error:
        reason = f"{error!s:.400}".strip().splitlines()[0]
        return FailedUnit(unit, reason, WorkerDied(reason))


def run_units(
    task: Callable[[Unit], Result], units: Iterable[Unit], jobs: int
) -> Generator[tuple[int, Result | FailedUnit]]:
    """`task(unit)` of each unit as it is finished, with the number of the unit, on `jobs` processes.

    A unit that raises, or whose process dies, gives a `FailedUnit`; the process is replaced, and the others go on. With
    one job everything runs here. The processes end with the generator: after `close()`, or an exception such as Ctrl-C.
    """
    numbered = enumerate(units)
    if jobs == 1:
        yield from ((number, attempt(task, unit)) for number, unit in numbered)
        return
    busy: Busy = {}
    idle = list[Worker]()
    try:
        while _hand_out(task, islice(numbered, jobs - len(busy)), busy, idle):
            yield from _finished(busy, idle)
    finally:
        for worker in (*busy, *idle):
            worker.process.terminate()
        for worker in (*busy, *idle):
            worker.stop()


def _hand_out(task: Any, units: Iterable[tuple[int, Any]], busy: Busy, idle: list[Worker]) -> bool:
    """Give numbered units to idle workers, or to new ones; whether any worker has one then."""
    for number, unit in units:
        worker = idle.pop() if idle else Worker(task, "its process", START)
        busy[worker] = number, unit
        with suppress(WorkerDied):  # which its answer will say
            worker.ask("__call__", unit)
    return bool(busy)


def _finished(busy: Busy, idle: list[Worker]) -> list[tuple[int, Any]]:
    """What is finished within a moment."""
    pipes: Any = wait([worker.pipe for worker in busy], POLL_S)
    ready = [(worker, busy.pop(worker)) for worker in list(busy) if worker.pipe in pipes]
    return [(number, _answer(worker, unit, idle)) for worker, (number, unit) in ready]


def _answer(worker: Worker, unit: Any, idle: list[Worker]) -> Any:
    """What a worker made of its unit; unless it died, it is idle then."""
    try:
        result = worker.answer()
    except WorkerDied as error:
        worker.stop()
        return FailedUnit(unit, str(error), error)
    idle.append(worker)
    if isinstance(result, Failure):
        result.error.add_note(result.note)
        return FailedUnit(unit, result.reason, result.error)
    return result


@dataclass(frozen=True, slots=True)
class Shard:
    """A part of the work: every `count`-th unit, from unit `number` on, which counts from 1."""

    number: int
    count: int

    @classmethod
    def parse(cls, text: str) -> Self:
        """The part `NUMBER/COUNT`. Raises `ConfigError`."""
        found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text, re.ASCII)
        if not found or not 1 <= int(found[1]) <= int(found[2]):
            raise ConfigError(f"shard: {text!r:.80}, expected NUMBER/COUNT such as 1/4, with 1 <= NUMBER <= COUNT")
        return cls(int(found[1]), int(found[2]))

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def part(self, units: Sequence[Unit]) -> Sequence[Unit]:
        """The units of this part."""
        return units[self.number - 1 :: self.count]


WHOLE = Shard(1, 1)


class KeptResults:
    """The results in a folder, each of the type `kind`, that belong to a `run`: its configuration and its code."""

    def __init__(self, folder: Path, kind: Any, run: Mapping[str, Any]) -> None:
        """Read what is there. Raises `ConfigError` for a file that is damaged or of another run."""
        self.folder, self._kind, self._run = folder, TypeAdapter(kind), json.loads(json.dumps(run))
        self.found: dict[str, Any] = dict(map(self._read, sorted(folder.glob("[!.]*.json"))))

    def keep(self, name: str, result: Any) -> Any:
        """Write the result of the unit `name`, unless another process was faster; the result as its file has it."""
        path = self.folder / f"{NOT_A_NAME.sub('_', name):.60}-{checksum(name.encode())}.json"
        if not path.exists():
            plain = json.loads(json.dumps(result, default=_plain))
            content = {"format": FORMAT, "version": VERSION, "run": self._run, "unit": name, "result": plain}
            write_atomic(path, (json.dumps(content | {"checksum": _checksum(content)}) + "\n").encode())
        _, self.found[name] = self._read(path)
        return self.found[name]

    def _read(self, path: Path) -> tuple[str, Any]:
        try:
            content = json.loads(path.read_bytes())
            if content["format"] != FORMAT:
                raise ValueError(f"its format is {content['format']!r:.40}")
            self._check_run(path, content["version"], content["run"])
            if content.pop("checksum") != _checksum(content):
                raise ValueError("its checksum is that of another content")
            return str(content["unit"]), self._kind.validate_python(content["result"])
        except ConfigError:
            raise
        except OSError as error:
            raise ConfigError(f"{path}: {error.strerror}") from None
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:  # of pydantic, too
            reason = f"{type(error).__name__}: {error}".splitlines()[0]
            raise ConfigError(f"{path}: damaged, or no result of mecp_env ({reason:.120}); remove it") from None

    def _check_run(self, path: Path, version: int, run: dict[str, Any]) -> None:
        """Raise `ConfigError` for a file of another version or run."""
        if version != VERSION:
            raise ConfigError(f"{path}: version {version!r:.20}, this mecp_env reads version {VERSION}")
        names = [name for name in {**self._run, **run} if run.get(name) != self._run.get(name)]
        if names:
            there, here = (", ".join(f"{name} {one.get(name)!r:.60}" for name in names) for one in (run, self._run))
            raise ConfigError(
                f"{self.folder} has results of another run: {there}; this one has {here}; "
                "choose another folder, or remove that one"
            )


def run_kept(
    task: Callable[[Unit], Any], units: Mapping[str, Unit], kept: KeptResults, jobs: int, cluster: str = ""
) -> Generator[tuple[str, Any]]:
    """The name of each unit with its result: first those that are kept already, then the others as they are finished.

    They run on `jobs` processes here, or on the Ray cluster at the address `cluster`. A `FailedUnit` is not kept: the
    next run repeats the unit. Raises `OSError` when a result cannot be written, `ConfigError` for a wrong cluster.
    """
    yield from [(name, kept.found[name]) for name in units if name in kept.found]
    todo = [name for name in units if name not in kept.found]
    waiting = [units[name] for name in todo]
    with closing(run_on_cluster(task, waiting, cluster) if cluster else run_units(task, waiting, jobs)) as finished:
        for number, result in finished:
            name = todo[number]
            yield name, result if isinstance(result, FailedUnit) else kept.keep(name, result)


def _checksum(content: Mapping[str, Any]) -> str:
    return checksum(json.dumps(content).encode())


def _plain(value: Any) -> Any:
    """A dataclass, or a number or array of NumPy, as JSON has it."""
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"a result holds no {type(value).__name__}")
