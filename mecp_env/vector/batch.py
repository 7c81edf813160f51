"""Many environments in few processes, each of which holds a slice of them and answers once per step."""

from __future__ import annotations

import contextlib
import copy
import functools
import itertools
import multiprocessing
import weakref
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import AlreadyPendingCallError, ClosedEnvironmentError, NoAsyncCallError, ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from mecp_env.core.processes import Failure, WorkerDied, WorkerPool, cores, start_method
from mecp_env.env import MecpEnv
from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.vector.checks import Seeds, check_count, check_ids, check_integer, check_mode, check_options, check_seeds
from mecp_env.vector.worker import (
    ALONE,
    INFO,
    MASK,
    OBSERVATION,
    RECORD,
    RESULT,
    Blocks,
    Flights,
    Info,
    Infos,
    Makers,
    WorkerEnvironments,
    below,
    copied,
    info_names,
    shared_blocks,
)
from mecp_env.wrappers import GoalActions

Add = Callable[[Info, Info, int], Info]  # Gymnasium's own `_add_info`
Bools = NDArray[np.bool_]
Step = tuple[Any, NDArray[np.float64], Bools, Bools, dict[str, Any]]
STEPS, DRIVES = 1, 2  # workers a core: steps take equally long; drives do not, and the system evens them out
RESERVED = ("reset", "step", "close")  # not for `call`


class BatchEnv(VectorEnv[Any, Any, Any]):
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

    closed = True  # until there are workers: Gymnasium below 1.4 closes what a failed construction leaves

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
        self.num_envs = self.batch_size = check_integer("num_envs", len(makers))
        self.copy, self._mode = copy, check_mode(autoreset_mode)
        if batch_size is not None:
            self.batch_size = check_integer("batch_size", batch_size, len(makers), ", or None for all")
        if workers is not None:
            check_integer("workers", workers, otherwise=", or None for as many as fit")
        method = start_method(context)
        blocks = self._describe(makers[0](), multiprocessing.get_context(method))
        self._slices = slices(self.num_envs, workers, DRIVES if self.masked else STEPS)
        local = workers is None and (not self.masked or self.num_envs == 1)  # a drive would delay what `recv` returns
        self._buffers = {name: block.view() for name, block in blocks.items()}
        self._seen, self._records = below(self._buffers, OBSERVATION), self._buffers[RECORD]
        self._pending: str | None = None
        self._fresh = np.ones(self.num_envs, np.bool_)  # never reset
        self._stale = self._fresh.copy()  # to be reset before the next step
        if len(self._slices) > local:
            share_functions(method)
        self._pool = WorkerPool(self._targets(makers, blocks), method, local)
        self._flights = Flights(self._pool, self._slices)
        self._close_pool = weakref.finalize(self, self._pool.close)
        self.closed = False

    @property
    def autoreset_mode(self) -> AutoresetMode:
        """What happens when an episode ends, as the vector classes of Gymnasium name it."""
        return self._mode

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
        infos, records = self._answers(), copied(self._records)
        return *self._results(slice(None), records), self._batched(infos, records, ~self._fresh)

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
        rest: Infos = {}
        for row, (env, answer) in enumerate(landed.items()):
            if isinstance(answer, Failure):
                self._stale[env] = True
                answer.error.add_note(answer.note)
                raise answer.error
            rest[row] = answer
        envs = np.array(list(landed))
        records = self._records[envs]
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

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """For each environment what its method `name` returns, or its attribute of that name."""
        if name in RESERVED:
            raise ValueError(f"call({name!r}): the batch has a method of that name")
        return tuple(self.each(call, [(name, args, kwargs)] * self.num_envs))

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """The attribute of that name of each environment."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute: to the entries of a list or tuple of N values, or everywhere to the same."""
        several = isinstance(values, list | tuple)
        self.each(_set_attribute, [(name, value) for value in (values if several else [values] * self.num_envs)])

    def each(self, function: Callable[..., Any], arguments: Sequence[tuple[Any, ...] | None]) -> list[Any]:
        """What `function(environment, *arguments[i])` returns, run by the worker of each environment i.

        An environment whose arguments are None is left out. The function must be found under its name in a module, as
        pickle wants it. Raises `ValueError` for another number of arguments than of environments.
        """
        self._assert_free("call")
        if len(arguments) != self.num_envs:
            raise ValueError(f"{len(arguments)} values, expected one for each of {self.num_envs} environments")
        answers = self._ask("each", [(function, arguments[own.start : own.stop]) for own in self._slices])
        return [found for part in answers for found in part]

    def render(self) -> tuple[Any, ...] | None:
        """A frame (H,W,3) of each environment in the mode "rgb_array"; None without a mode."""
        return self.call("render") if self.render_mode is not None else None

    def close_extras(self, **kwargs: Any) -> None:
        """Stop the workers, whatever they are doing; `close` calls it, once."""
        self._close_pool()

    @property
    def pids(self) -> list[int]:
        """Of the worker processes, which may be none."""
        return self._pool.pids

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """Copies of the generators of the environments."""
        return copy.deepcopy(self.get_attr("np_random"))

    @property
    def np_random_seed(self) -> tuple[int | None, ...]:  # type: ignore[override]
        """The seeds of the environments."""
        return self.get_attr("np_random_seed")

    def _describe(self, env: gymnasium.Env[Any, Any], context: Any) -> Blocks:
        """Take spaces and metadata from an environment of the batch's kind; the memory for its results.

        The environment runs for a step, so that the cache has what every step calls.
        """
        self.metadata = {**env.metadata, "autoreset_mode": self._mode}
        self.render_mode = env.render_mode
        self.single_observation_space, self.single_action_space = env.observation_space, env.action_space
        self.observation_space = batch_space(env.observation_space, self.num_envs)
        self.action_space = batch_space(env.action_space, self.num_envs)
        _, info = env.reset(seed=0)
        env.step(_still(env.action_space))
        choices = _masked_choices(env)
        self.masked = choices > 0
        env.close()
        return shared_blocks(self.num_envs, env.observation_space, info, choices, context)

    def _targets(self, makers: Makers, blocks: Blocks) -> dict[str, WorkerEnvironments]:
        """What each worker holds, by the name of the worker."""
        kinds = self.single_observation_space, self.single_action_space
        return {
            f"worker {number} (environments {own[0]} to {own[-1]})": WorkerEnvironments(
                own.start, makers[own.start : own.stop], blocks, self._mode, kinds
            )
            for number, own in enumerate(self._slices)
        }

    def _assert_open(self, name: str) -> None:
        if self.closed:
            raise ClosedEnvironmentError(f"{name}() of a batch that is closed")
        if self._pending:
            raise AlreadyPendingCallError(f"{name}() while {self._pending}() is under way", self._pending)

    def _assert_free(self, name: str) -> None:
        self._assert_open(name)
        self._flights.check_free(range(self.num_envs), f"{name}()")

    def _assert_reset(self, name: str, envs: NDArray[np.intp] | slice = slice(None)) -> None:
        if self._stale[envs].any():
            stale = np.arange(self.num_envs)[envs][self._stale[envs]]
            raise ResetNeeded(f"{name}() before reset() of the environments {stale.tolist()}")

    @contextlib.contextmanager
    def _closed_by(self, error: type[Exception]) -> Iterator[None]:
        try:
            yield
        except error:
            self.close()
            raise

    def _ask(self, name: str, arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
        self._begin(name, arguments)
        return self._answers()

    def _begin(self, name: str, arguments: Sequence[tuple[Any, ...]]) -> None:
        self._pending = name
        with self._closed_by(WorkerDied):
            self._pool.ask(name, arguments)

    def _answers(self) -> list[Any]:
        with self._closed_by(WorkerDied):
            try:
                answers = self._pool.gather()
            except Exception:  # after Ctrl-C, the answers are still to come
                self._pending = None
                raise
        self._pending = None
        return answers

    def _depart(self, name: str, items: dict[int, tuple[Any, ...]]) -> None:
        with self._closed_by(WorkerDied):
            self._flights.send(name, items)

    def _results(self, envs: Any, records: NDArray[Any]) -> tuple[Any, NDArray[np.float64], Bools, Bools]:
        """Observations, rewards, terminated and truncated of environments that have come back."""
        reward, terminated, truncated = (records[name].copy() for name in RESULT[:3])
        over = (terminated | truncated) & (self._mode == AutoresetMode.DISABLED)
        self._fresh[envs], self._stale[envs] = False, over
        return self._observations(envs), reward, terminated, truncated

    def _observations(self, envs: Any = slice(None)) -> Any:
        """Of some environments; of all, views unless the batch copies."""
        seen = {name: array[envs].copy() if self.copy else array[envs] for name, array in self._seen.items()}
        return seen.get(ALONE, seen)

    def _batched(self, shared: list[Infos], records: NDArray[Any], chosen: Bools) -> dict[str, Any]:
        """The infos of the chosen environments as Gymnasium batches them: an array and a mask for each key."""
        rest = {env: info for part in shared for env, info in part.items()}
        return batched_infos(records, chosen, rest, self._add_info)


def batched_infos(records: NDArray[Any], chosen: Bools, rest: Infos, add: Add) -> Info:
    """The infos of the chosen environments: the numbers of their records (n,), which are overwritten, and the rest.

    `rest` is by row of the records; `add` makes arrays with a row for each environment of the batch, at least n.
    """
    infos, left = _of_records(records, records["listed"] & chosen), {row: info for row, info in rest.items() if info}
    for row, info in left.items():
        infos = add(infos, info, row)
    return _first_rows(infos, len(records)) if left else infos


def _first_rows(infos: Info, count: int) -> Info:
    return {name: _first_rows(part, count) if isinstance(part, dict) else part[:count] for name, part in infos.items()}


def _of_records(records: NDArray[Any], listed: Bools) -> Info:
    """The numbers of the listed environments; where these are all, one mask is that of every key."""
    if not listed.any():
        return {}
    complete = bool(listed.all())
    records[~listed] = 0
    names = info_names(records.dtype)
    numbers: Info = {name: records[INFO + name] for name in names}
    return numbers | {f"_{name}": listed if complete else listed.copy() for name in names}


@functools.cache
def load() -> None:
    """Have the functions of an episode loaded, once per process: those that are forked later share their memory."""
    env, policy = MecpEnv(layout="two_rooms"), BreadthFirst()
    goals = GoalActions(env)
    observation, _ = goals.reset(seed=0)
    over = False
    while not over:
        observation, _, terminated, truncated, _ = goals.step(policy.act(observation, goals.action_masks()))
        over = terminated or truncated
    env.summary()


def share_functions(method: str) -> None:
    """Have compiled functions loaded where workers are forked: each would otherwise have a copy of its own."""
    if method == "fork":
        load()
    elif method == "forkserver":
        multiprocessing.set_forkserver_preload(["__main__", "mecp_env.vector.preload"])


def slices(count: int, workers: int | None, each_core: int = 1) -> list[range]:
    """Numbers of the environments of each worker; `workers` None makes `each_core` per core."""
    workers = min(count, workers or each_core * cores())
    ends = [count * k // workers for k in range(workers + 1)]
    return [range(first, end) for first, end in itertools.pairwise(ends)]


def _still(space: spaces.Space[Any]) -> Any:
    """An action of zeros: to stand still, or the first choice."""
    return np.zeros(space.shape or (), space.dtype)


def _masked_choices(env: gymnasium.Env[Any, Any]) -> int:
    """How many choices the environment masks; 0 where it masks none."""
    space = env.action_space
    return int(space.n) if isinstance(space, spaces.Discrete) and env.has_wrapper_attr("action_masks") else 0


def call(env: gymnasium.Env[Any, Any], name: str, arguments: tuple[Any, ...], keywords: dict[str, Any]) -> Any:
    """What the method `name` of an environment returns, or its attribute of that name."""
    found = env.get_wrapper_attr(name)
    return found(*arguments, **keywords) if callable(found) else found


def _set_attribute(env: gymnasium.Env[Any, Any], name: str, value: Any) -> None:
    env.set_wrapper_attr(name, value)
