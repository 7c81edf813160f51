"""Many environments in few processes, each of which holds a slice of them and answers once per step."""

from __future__ import annotations

import itertools
import multiprocessing
import weakref
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import AlreadyPendingCallError, ClosedEnvironmentError, NoAsyncCallError, ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from mecp_env.core.processes import WorkerDied, WorkerPool, cores, start_method
from mecp_env.vector.checks import Seeds, check_copy, check_mode, check_options, check_seeds, check_workers
from mecp_env.vector.shared_buffers import ALONE, INFO, OBSERVATION, Fields, below, lay_out, memory_bytes, plan_fields
from mecp_env.vector.worker import Infos, Makers, WorkerEnvironments

STEPS, DRIVES = 1, 4  # workers a core: steps take equally long; drives do not, and the system evens them out
RESERVED = ("reset", "step", "close")  # not for `call`

Bools = NDArray[np.bool_]
Step = tuple[Any, NDArray[np.float64], Bools, Bools, dict[str, Any]]


class BatchEnv(VectorEnv[Any, Any, Any]):
    """`N` environments in `workers` processes (one a core), bit for bit what each would do alone.

    Observations, rewards and the numbers of `info` come through shared memory, and a worker is sent one message a step,
    however many environments it holds. The arguments: `makers`, a function for each environment; `workers`;
    `autoreset_mode`, "NextStep", "SameStep" or "Disabled"; `context`, how processes are started (see `start_method`);
    with `copy=False` observations are views that the next step overwrites.

    An exception in an environment is raised here with its own type and text; `reset` goes on. When a worker dies, the
    batch is closed and `WorkerDied` names it. A batch without references closes itself.
    """

    def __init__(
        self,
        makers: Makers,
        *,
        workers: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        context: str | None = None,
        copy: bool = True,
    ) -> None:
        if not makers:
            raise ValueError("num_envs: 0, expected at least 1")
        self.num_envs, self.copy, self._mode = len(makers), check_copy(copy), check_mode(autoreset_mode)
        check_workers(workers)
        method = start_method(context)
        fields = self._describe(makers[0]())
        self._slices = slices(self.num_envs, workers, DRIVES if self.masked else STEPS)
        memory = multiprocessing.get_context(method).RawArray("B", memory_bytes(fields))
        self._buffers = lay_out(fields, memory)
        self._seen, self._listed = below(self._buffers, OBSERVATION), below(self._buffers, INFO)
        self._pending: str | None = None
        self._fresh = self._stale = np.ones(self.num_envs, np.bool_)  # never reset; to be reset before the next step
        self._pool = WorkerPool(self._targets(makers, fields, memory), method)
        self._close_pool = weakref.finalize(self, self._pool.close)

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
        return self._observations(), self._batched(infos, chosen)

    def step(self, actions: Any) -> Step:
        """One step in every environment: observations, rewards (N,), terminated (N,), truncated (N,), infos."""
        self.step_async(actions)
        return self.step_wait()

    def step_async(self, actions: Any) -> None:
        """Have the workers begin a step. Raises `ResetNeeded` where an environment must be reset first."""
        self._assert_free("step")
        if len(actions) != self.num_envs:
            raise ValueError(f"actions: {len(actions)} of them, expected one for each of {self.num_envs} environments")
        if self._stale.any():
            raise ResetNeeded(f"step() before reset() of the environments {np.flatnonzero(self._stale).tolist()}")
        self._begin("step", [(actions[own.start : own.stop],) for own in self._slices])

    def step_wait(self) -> Step:
        """What the step that `step_async` began gave."""
        if self._pending != "step":
            raise NoAsyncCallError("step_wait() without step_async()", "step")
        self._stale = ~self._fresh  # should an environment raise
        infos = self._answers()
        reward, terminated, truncated = (self._buffers[name].copy() for name in ("reward", "terminated", "truncated"))
        self._stale = (terminated | truncated) & (self._mode == AutoresetMode.DISABLED)
        return self._observations(), reward, terminated, truncated, self._batched(infos, ~self._fresh)

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """For each environment what its method `name` returns, or its attribute of that name."""
        if name in RESERVED:
            raise ValueError(f"call({name!r}): the batch has a method of that name")
        return tuple(self.each(_call, [(name, args, kwargs)] * self.num_envs))

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

    def action_masks(self) -> Bools:
        """(N,32) which rows of each observation hold a goal; no worker is asked.

        Raises `AttributeError` without goal actions, `ResetNeeded` before the first `reset`.
        """
        masks: Bools = self._buffers["mask"]
        if not self.masked:
            raise AttributeError("action_masks: these environments have none; those with actions='goal' have")
        if self._fresh.any():
            raise ResetNeeded("action_masks() before reset()")
        return masks.copy()

    def render(self) -> tuple[Any, ...] | None:
        """A frame (H,W,3) of each environment in the mode "rgb_array"; None without a mode."""
        return self.call("render") if self.render_mode is not None else None

    def close_extras(self, **kwargs: Any) -> None:
        """Stop the workers, whatever they are doing; `close` calls it, once."""
        self._close_pool()

    @property
    def pids(self) -> list[int]:
        """Of the workers."""
        return self._pool.pids

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """Copies of the generators of the environments."""
        return self.get_attr("np_random")

    @property
    def np_random_seed(self) -> tuple[int | None, ...]:  # type: ignore[override]
        """The seeds of the environments."""
        return self.get_attr("np_random_seed")

    def _describe(self, env: gymnasium.Env[Any, Any]) -> Fields:
        """Take spaces and metadata from an environment of the batch's kind; what it needs of the buffers.

        The environment runs for a step, so that every compiled function is loaded: forked workers then have them,
        others find them in the cache.
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
        return plan_fields(self.num_envs, env.observation_space, info, choices)

    def _targets(self, makers: Makers, fields: Fields, memory: Any) -> dict[str, WorkerEnvironments]:
        """What each worker holds, by the name of the worker."""
        kinds = self.single_observation_space, self.single_action_space
        return {
            f"worker {number} (environments {own[0]} to {own[-1]})": WorkerEnvironments(
                own.start, makers[own.start : own.stop], fields, memory, self._mode, kinds
            )
            for number, own in enumerate(self._slices)
        }

    def _assert_free(self, name: str) -> None:
        if self.closed:
            raise ClosedEnvironmentError(f"{name}() of a batch that is closed")
        if self._pending:
            raise AlreadyPendingCallError(f"{name}() while {self._pending}() is under way", self._pending)

    def _ask(self, name: str, arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
        self._begin(name, arguments)
        return self._answers()

    def _begin(self, name: str, arguments: Sequence[tuple[Any, ...]]) -> None:
        self._pending = name
        try:
            self._pool.ask(name, arguments)
        except WorkerDied:
            self.close()
            raise

    def _answers(self) -> list[Any]:
        try:
            answers = self._pool.gather()
        except WorkerDied:
            self.close()
            raise
        except Exception:
            self._pending = None
            raise
        self._pending = None
        return answers

    def _observations(self) -> Any:
        seen = {name: array.copy() if self.copy else array for name, array in self._seen.items()}
        return seen if isinstance(self.single_observation_space, spaces.Dict) else seen[ALONE]

    def _batched(self, shared: list[Infos], chosen: Bools) -> dict[str, Any]:
        """The infos of the chosen environments as Gymnasium batches them: an array and a mask for each key."""
        listed = self._buffers["listed"] & chosen
        infos = dict[str, Any]()
        if listed.any():
            for name, column in self._listed.items():
                infos[name], infos[f"_{name}"] = column.copy(), listed.copy()
                infos[name][~listed] = 0
        for env, rest in (item for part in shared for item in part.items()):
            infos = self._add_info(infos, rest, env)
        return infos


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


def _call(env: gymnasium.Env[Any, Any], name: str, arguments: tuple[Any, ...], keywords: dict[str, Any]) -> Any:
    found = env.get_wrapper_attr(name)
    return found(*arguments, **keywords) if callable(found) else found


def _set_attribute(env: gymnasium.Env[Any, Any], name: str, value: Any) -> None:
    env.set_wrapper_attr(name, value)
