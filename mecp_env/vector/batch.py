"""Many environments in few processes, each of which holds a slice of them and answers once per step."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from gymnasium.error import NoAsyncCallError, ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from mecp_env.core.processes import Failure, WorkerDied
from mecp_env.vector.hosted import (
    HostedEnvs,
    Seeds,
    check_copy,
    check_count,
    check_ids,
    check_integer,
    check_mode,
    check_options,
    check_seeds,
)
from mecp_env.vector.worker import ALONE, INFO, MASK, RESULT, Info, Infos, Makers, copied, info_names

Add = Callable[[Info, Info, int], Info]  # Gymnasium's own `_add_info`
Bools = NDArray[np.bool_]
Step = tuple[Any, NDArray[np.float64], Bools, Bools, dict[str, Any]]


def batched_infos(records: NDArray[Any], chosen: NDArray[np.bool_], rest: Infos, add: Add) -> Info:
    """The infos of the chosen environments: the numbers of their records (n,), which are overwritten, and the rest.

    `rest` is by row of the records; `add` makes arrays with a row for each environment of the batch, at least n.
    """
    infos = _of_records(records, records["listed"] & chosen)
    others = {row: left for row, info in rest.items() if (left := _without_texts(infos, info, row, len(records)))}
    for row, info in others.items():
        infos = add(infos, info, row)
    return _first_rows(infos, len(records)) if others else infos


def _first_rows(infos: Info, count: int) -> Info:
    return {name: _first_rows(part, count) if isinstance(part, dict) else part[:count] for name, part in infos.items()}


def _of_records(records: NDArray[Any], listed: NDArray[np.bool_]) -> Info:
    """The numbers of the listed environments; where these are all, one mask is that of every key."""
    if not listed.any():
        return {}
    complete = bool(listed.all())
    if not complete:
        records[~listed] = 0
    columns, masks = _columns(records.dtype)
    infos: Info = {name: records[field] for name, field in columns}
    return infos | (dict.fromkeys(masks, listed) if complete else {mask: listed.copy() for mask in masks})


@cache
def _columns(record: np.dtype[Any]) -> tuple[list[tuple[str, str]], list[str]]:
    """The keys of an info that records hold: each with the name of its field; and the keys of their masks."""
    names = info_names(record)
    return [(name, INFO + name) for name in names], [f"_{name}" for name in names]


def _without_texts(infos: Info, info: Info, row: int, count: int) -> Info:
    """Add the texts of an info, which each step has, as Gymnasium would; the others of its entries."""
    others = {}
    for name, value in info.items():
        if type(value) is not str:
            others[name] = value
            continue
        if name not in infos:
            infos[name], infos[f"_{name}"] = np.full(count, None, object), np.zeros(count, np.bool_)
        infos[name][row], infos[f"_{name}"][row] = value, True
    return others


class BatchEnv(HostedEnvs, VectorEnv[Any, Any, Any]):  # skrl looks for a direct base of that name
    """`N` environments on all cores, or in `workers` processes, bit for bit what each would do alone.

    Without `workers`, this process steps the first slice of the environments while worker processes step the others; a
    single environment needs no process. With goal actions, only processes step several environments, two per core.

    Observations, rewards and the numbers of `info` come through shared memory, and a worker is sent one message a step,
    however many environments it holds. `step` waits for all environments; `send` and `recv` serve those first that are
    finished first.

    The arguments: `makers`, a function for each environment; `workers`; `batch_size`, how many environments `recv`
    returns; `autoreset_mode`, "NextStep", "SameStep" or "Disabled"; `context`, how processes are started (see
    `start_method`); with `copy=False` the observations of `reset` and `step` are views that the next step overwrites.

    An exception in an environment is raised here with its own type and text; `reset` goes on. When a worker dies, the
    batch is closed and `WorkerDied` names it. A batch without references closes itself.
    """

    def __init__(
        self,
        makers: Makers,
        *,
        workers: int | None = None,
        batch_size: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        context: str | None = None,
        copy: bool = True,
    ) -> None:
        self.copy, mode = check_copy(copy), check_mode(autoreset_mode)
        self.batch_size = len(makers)
        if batch_size is not None:
            self.batch_size = check_integer("batch_size", batch_size, len(makers), ", or None for all")
        super().__init__(makers, workers, mode, context)
        self._fresh = np.ones(self.num_envs, np.bool_)  # never reset
        self._stale = self._fresh.copy()  # to be reset before the next step

    def reset(self, *, seed: Seeds = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """First observations and infos of new episodes, in all environments or in those of a mask.

        `seed`: environment i gets `seed + i`; or a list of seeds. `options["reset_mask"]`: (N,) bool, which to reset;
        the other options go to each environment.
        """
        self._assert_free("reset")
        seeds = check_seeds(seed, self.num_envs)
        rest, chosen = check_options(options, self.num_envs)
        self._stale = self._stale | chosen
        infos = self._ask("reset", [(seeds[s.start : s.stop], rest, chosen[s.start : s.stop]) for s in self._slices])
        self._fresh, self._stale = self._fresh & ~chosen, self._stale & ~chosen
        return self._observations(), self._batched(infos, copied(self._records), chosen)

    def step(self, actions: Any) -> Step:
        """One step in every environment: observations, rewards (N,), terminated (N,), truncated (N,), infos."""
        self.step_async(actions)
        return self.step_wait()

    def step_async(self, actions: Any) -> None:
        """Have the workers begin a step. Raises `ResetNeeded` where an environment must be reset first."""
        self._assert_free("step")
        check_count(actions, self.num_envs, "environments")
        self._assert_reset("step")
        self._begin("step", [(actions[own.start : own.stop],) for own in self._slices])

    def step_wait(self) -> Step:
        """What the step that `step_async` began gave."""
        if self._pending != "step":
            raise NoAsyncCallError("step_wait() without step_async()", "step")
        self._stale = ~self._fresh  # should an environment raise
        infos = self._answers()
        records = copied(self._records)
        reward, terminated, truncated = (records[name].copy() for name in RESULT[:3])
        self._stale = self._must_reset(terminated | truncated)
        return self._observations(), reward, terminated, truncated, self._batched(infos, records, ~self._fresh)

    def async_reset(self, *, seed: Seeds = None, options: dict[str, Any] | None = None) -> None:
        """Have the workers begin new episodes, as `reset` would; `recv` returns the first observations, with reward 0.

        Raises `AlreadyPendingCallError` for an environment that is under way.
        """
        self._assert_open("async_reset")
        seeds = check_seeds(seed, self.num_envs)
        rest, chosen = check_options(options, self.num_envs)
        envs = np.flatnonzero(chosen).tolist()
        self._flights.check_free(envs, "async_reset()")
        self._stale[envs] = True
        self._depart("reset", {env: (seeds[env], rest) for env in envs})

    def send(self, actions: Any, env_ids: Any = None) -> None:
        """Have the workers begin a step in some environments; `recv` returns those that are finished first.

        `actions`: one for each of `env_ids` (n,), or of all environments. Raises `ValueError` for wrong numbers,
        `AlreadyPendingCallError` for an environment that is under way, and `ResetNeeded`.
        """
        self._assert_open("send")
        envs = check_ids(env_ids, self.num_envs)
        check_count(actions, len(envs), "env_ids")
        self._flights.check_free(envs.tolist(), "send()")
        self._assert_reset("send", envs)
        self._depart("step", {env: (action,) for env, action in zip(envs.tolist(), actions, strict=True)})

    def recv(self) -> Step:
        """The `batch_size` environments that were finished first, or all that are under way if these are fewer.

        As from `step`, with rows in the order of `infos["env_id"]`, which ascends. An exception in an environment is
        raised; it has to be reset, the others can still be received. Raises `NoAsyncCallError` if none is under way.
        """
        self._assert_open("recv")
        if not len(self._flights):
            raise NoAsyncCallError("recv() without send() or async_reset()", "recv")
        with self._closed_by(Exception):
            landed = self._flights.take(min(self.batch_size, len(self._flights)))
        envs, records, rest = self._landed(landed)
        infos = batched_infos(records, np.ones(len(envs), np.bool_), rest, self._add_info)
        return *self._results(envs, records), infos | {"env_id": envs}

    def action_masks(self, env_ids: Any = None) -> Bools:
        """(n,32) which rows of each observation hold a goal, of `env_ids` or all environments; no worker is asked.

        Raises `AttributeError` without goal actions, `ResetNeeded` before the first `reset`, and
        `AlreadyPendingCallError` for an environment that is under way.
        """
        masks: Bools = self._buffers[MASK]
        if not self.masked:
            raise AttributeError("action_masks: these environments have none; those with actions='goal' have")
        envs = check_ids(env_ids, self.num_envs)
        self._flights.check_free(envs.tolist(), "action_masks()")
        if self._fresh[envs].any():
            raise ResetNeeded("action_masks() before reset()")
        return masks[envs]

    def _assert_reset(self, name: str, envs: NDArray[np.intp] | slice = slice(None)) -> None:
        if self._stale[envs].any():
            stale = np.arange(self.num_envs)[envs][self._stale[envs]]
            raise ResetNeeded(f"{name}() before reset() of the environments {stale.tolist()}")

    def _must_reset(self, over: Bools) -> Bools:
        return over & (self._mode == AutoresetMode.DISABLED)

    def _depart(self, name: str, items: dict[int, tuple[Any, ...]]) -> None:
        with self._closed_by(WorkerDied):
            self._flights.send(name, items)

    def _landed(self, landed: dict[int, Info | Failure]) -> tuple[NDArray[np.intp], NDArray[Any], Infos]:
        """Numbers, records and, by row, the rests of the infos of environments. Raises the exception of one of them."""
        rest: Infos = {}
        for row, (env, answer) in enumerate(landed.items()):
            if isinstance(answer, Failure):
                self._stale[env] = True
                answer.error.add_note(answer.note)
                raise answer.error
            rest[row] = answer
        envs = np.array(list(landed))
        return envs, self._records[envs], rest

    def _results(self, envs: NDArray[np.intp], records: NDArray[Any]) -> tuple[Any, NDArray[np.float64], Bools, Bools]:
        """Observations, rewards, terminated and truncated of environments that have come back."""
        reward, terminated, truncated = (records[name].copy() for name in RESULT[:3])
        self._fresh[envs], self._stale[envs] = False, self._must_reset(terminated | truncated)
        return self._observations(envs), reward, terminated, truncated

    def _observations(self, envs: Any = None) -> Any:
        """Of the environments `envs`, or of all; of all, views unless the batch copies."""
        if envs is not None:
            seen = {name: array[envs] for name, array in self._seen.items()}
        else:
            seen = {name: array.copy() if self.copy else array for name, array in self._seen.items()}
        return seen.get(ALONE, seen)

    def _batched(self, shared: list[Infos], records: NDArray[Any], chosen: Bools) -> dict[str, Any]:
        """The infos of the chosen environments as Gymnasium batches them: an array and a mask for each key."""
        rest = {env: info for part in shared for env, info in part.items()}
        return batched_infos(records, chosen, rest, self._add_info)
