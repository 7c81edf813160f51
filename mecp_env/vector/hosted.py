"""Environments in this and in worker processes: how they are started, asked for anything but steps, and closed.

What a user gives to a batch, checked: seeds, options of a reset, the autoreset mode, counts, copies.

One exploration, by which compiled functions are loaded before workers are forked.
"""

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
from gymnasium.error import AlreadyPendingCallError, ClosedEnvironmentError
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from mecp_env.core.errors import ConfigError
from mecp_env.core.processes import WorkerDied, WorkerPool, cores, start_method
from mecp_env.env import MecpEnv
from mecp_env.episode.start import check_seed
from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.vector.worker import (
    OBSERVATION,
    RECORD,
    Blocks,
    Flights,
    Makers,
    WorkerEnvironments,
    below,
    shared_blocks,
)
from mecp_env.wrappers import GoalActions

Seeds = int | Sequence[int | None] | None
MASK = "reset_mask"


def check_mode(mode: str | AutoresetMode) -> AutoresetMode:
    """The autoreset mode of that name. Raises `ValueError`."""
    try:
        return AutoresetMode(mode)
    except ValueError:
        names = ", ".join(repr(known.value) for known in AutoresetMode)
        raise ValueError(f"autoreset_mode: {mode!r}, expected one of {names}") from None


def check_integer(name: str, value: Any, most: int | None = None, otherwise: str = "") -> int:
    """`value` itself. Raises `ValueError` unless it is an integer from 1 to `most`."""
    if not _is_integer(value) or value < 1 or (most is not None and value > most):
        bounds = "of at least 1" if most is None else f"from 1 to {most}"
        raise ValueError(f"{name}: {value!r:.80}, expected an integer {bounds}{otherwise}")
    return int(value)


def check_ids(ids: Any, count: int) -> NDArray[np.intp]:
    """The numbers of environments (n,). Raises `ValueError` for what is no number, out of range, or given twice."""
    numbers = np.arange(count) if ids is None else np.asarray(ids)
    expected = f"expected different numbers of environments from 0 to {count - 1}"
    if numbers.ndim != 1 or not numbers.size or not np.issubdtype(numbers.dtype, np.integer):
        raise ValueError(f"env_ids: {ids!r:.80}, {expected}")
    if numbers.min() < 0 or numbers.max() >= count or len(np.unique(numbers)) < len(numbers):
        raise ValueError(f"env_ids: {numbers.tolist()!r:.80}, {expected}")
    return numbers.astype(np.intp)


def check_count(actions: Any, count: int, whose: str) -> None:
    """Raise `ValueError` unless there is an action for each of `count`, in a list, a tuple or an array."""
    if not isinstance(actions, Sequence) and not getattr(actions, "ndim", 0):
        raise ValueError(f"actions: {actions!r:.80}, expected one for each of {count} {whose}")
    if len(actions) != count:
        raise ValueError(f"actions: {len(actions)} of them, expected one for each of {count} {whose}")


def check_copy(copy: bool) -> bool:
    """`copy` itself. Raises `ValueError` unless it is a boolean; the text "no" is not one."""
    if not isinstance(copy, bool | np.bool_):
        raise ValueError(f"copy: {copy!r:.80}, expected True or False")
    return bool(copy)


def check_seeds(seed: Seeds, count: int) -> list[int | None]:
    """A seed for each environment: `seed + i` of a number, the entries of a list. Raises `ValueError`."""
    expected = f"expected an integer, or one for each of {count} environments"
    if seed is None or _is_integer(seed):
        first = _checked_seed(seed, expected)
        return [None if first is None else first + i for i in range(count)]
    if not isinstance(seed, Sequence | np.ndarray):
        raise ValueError(f"seed: {seed!r:.80}, {expected}")
    if len(seed) != count:
        raise ValueError(f"seed: {len(seed)} of them, {expected}")
    return [_checked_seed(entry, expected) for entry in seed]


def _checked_seed(entry: Any, expected: str) -> int | None:
    try:
        return check_seed(entry)
    except ConfigError as error:
        raise ConfigError(f"{error}; {expected}") from None


def _is_integer(value: Any) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def check_options(options: dict[str, Any] | None, count: int) -> tuple[dict[str, Any] | None, NDArray[np.bool_]]:
    """The options for each environment, and which environments to reset (N,). Raises `TypeError`, `ValueError`."""
    if options is None or MASK not in options:
        return options, np.ones(count, np.bool_)
    mask = _checked_mask(options[MASK], count)
    return {name: value for name, value in options.items() if name != MASK} or None, mask.copy()


def _checked_mask(mask: Any, count: int) -> NDArray[np.bool_]:
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
        kind = f"an array of {mask.dtype}" if isinstance(mask, np.ndarray) else type(mask).__name__
        raise TypeError(f"options[{MASK!r}]: {kind}, expected a NumPy array of bool")
    if mask.shape != (count,) or not mask.any():
        raise ValueError(f"options[{MASK!r}]: {mask!r:.80}, expected shape ({count},) and at least one True")
    return mask


def explore(layout: str) -> None:
    """One exploration, and its scores."""
    env, policy = MecpEnv(layout=layout), BreadthFirst()
    goals = GoalActions(env)
    observation, _ = goals.reset(seed=0)
    over = False
    while not over:
        observation, _, terminated, truncated, _ = goals.step(policy.act(observation, goals.action_masks()))
        over = terminated or truncated
    env.summary()


@functools.cache
def load() -> None:
    """Have the functions of an episode loaded, once per process: those that are forked later share their memory."""
    explore("two_rooms")


STEPS, DRIVES = 1, 2  # workers a core: steps take equally long; drives do not, and the system evens them out
RESERVED = ("reset", "step", "close")  # not for `call`


class HostedEnvs(VectorEnv[Any, Any, Any]):
    """`N` environments in their slices and the shared buffers of their results."""

    closed = True  # until there are workers: Gymnasium below 1.4 closes what a failed construction leaves

    def __init__(self, makers: Makers, workers: int | None, mode: AutoresetMode, context: str | None) -> None:
        if not makers:
            raise ValueError("num_envs: 0, expected at least 1")
        self.num_envs, self._mode = len(makers), mode
        if workers is not None:
            check_integer("workers", workers, otherwise=", or None for as many as fit")
        method = start_method(context)
        blocks = self._describe(makers[0](), multiprocessing.get_context(method))
        self._slices = slices(self.num_envs, workers, DRIVES if self.masked else STEPS)
        local = workers is None and (not self.masked or self.num_envs == 1)  # a drive would delay what `recv` returns
        self._buffers = {name: block.view() for name, block in blocks.items()}
        self._seen, self._records = below(self._buffers, OBSERVATION), self._buffers[RECORD]
        self._pending: str | None = None
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
