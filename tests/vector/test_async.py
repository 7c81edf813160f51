"""`send` and `recv`: each environment goes as it would alone, first ready first served, and mistakes are named.

Also of a batch whose calling process steps environments itself.
"""

import multiprocessing
import time
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import AlreadyPendingCallError, ClosedEnvironmentError, NoAsyncCallError, ResetNeeded

from mecp_env.core.errors import ActionError
from mecp_env.core.processes import WorkerError
from mecp_env.vector import BatchEnv
from mecp_env.vector import batch as batching
from tests.env.helpers import same
from tests.processes import gone_within, needs_linux
from tests.vector.helpers import N, make_small, started

STILL = np.zeros((N, 2), np.float32)


class SlowFirst(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Takes long over a step when its action turns to the right, in a worker."""

    def step(self, action: Any) -> Any:
        time.sleep(0.3 if multiprocessing.parent_process() and action[1] < 0.0 else 0.0)
        return super().step(action)


@pytest.fixture(scope="module")
def batch() -> BatchEnv:
    return make_small(batch_size=2)


def histories(venv: BatchEnv, steps: int) -> list[list[Any]]:
    """All rows of each environment, driven by `send` and `recv`, each with actions of its own."""
    rows: list[list[Any]] = [[] for _ in range(N)]
    rngs = [np.random.default_rng(i) for i in range(N)]
    venv.async_reset(seed=11)
    while any(len(row) <= steps for row in rows):
        parts = venv.recv()
        ids = parts[-1].pop("env_id").tolist()
        for k, env in enumerate(ids):
            rows[env].append([row_of(part, k) for part in parts])
        going = [env for env in ids if len(rows[env]) <= steps]
        if going:
            venv.send(np.array([rngs[env].uniform(-0.5, 1.0, 2) for env in going], np.float32), going)
    return rows


def row_of(part: Any, k: int) -> Any:
    """Row `k` of a part of a batched result, of infos what is there."""
    if not isinstance(part, dict):
        return part[k]
    there = {name: inner for name, inner in part.items() if name[0] != "_" and part.get(f"_{name}", np.ones(N))[k]}
    return {name: row_of(inner, k) for name, inner in there.items()}


def test_all_at_once_gives_what_reset_and_step_give() -> None:
    one, other = make_small(max_steps=3), make_small(max_steps=3)
    one.async_reset(seed=1)
    other.reset(seed=1)
    assert one.recv()[-1].pop("env_id").tolist() == [0, 1, 2]
    for _ in range(5):
        one.send(STILL + 0.5)
        row = one.recv()
        row[-1].pop("env_id")
        assert same(row, other.step(STILL + 0.5))
    assert same(one.step(STILL), other.step(STILL))  # both interfaces in turn


def test_what_is_finished_first_is_served_first() -> None:
    venv = started(batch_size=1, wrappers=(SlowFirst,))
    actions = STILL.copy()
    actions[0, 1] = -0.5  # the only environment of its worker
    venv.send(actions)
    served = [venv.recv()[-1]["env_id"].tolist() for _ in range(N)]
    assert served[-1] == [0]
    assert sorted(served) == [[0], [1], [2]]


def test_a_batch_is_smaller_when_fewer_are_under_way(batch: BatchEnv) -> None:
    batch.reset(seed=1)
    batch.send(STILL)
    sizes = [len(batch.recv()[1]) for _ in range(2)]
    assert sizes == [2, 1]
    batch.send(STILL[:1], [2])
    observation, reward, *_, infos = batch.recv()
    assert infos["env_id"].tolist() == [2]
    assert infos["period"].tolist() == [2]
    assert len(observation["pose"]) == len(reward) == len(infos["_period"]) == 1


def test_a_mask_resets_some_while_others_are_under_way(batch: BatchEnv) -> None:
    batch.reset(seed=1)
    batch.send(STILL[:1], [1])
    batch.async_reset(seed=[7, 8, 9], options={"reset_mask": np.array([True, False, True])})
    periods: dict[int, int] = {}
    while len(periods) < N:
        infos = batch.recv()[-1]
        periods |= dict(zip(infos["env_id"].tolist(), infos["period"].tolist(), strict=True))
    assert periods == {0: 0, 1: 1, 2: 0}
    assert batch.np_random_seed == (7, 2, 9)


def test_wrong_numbers_of_environments_and_of_actions_are_refused(batch: BatchEnv) -> None:
    batch.reset(seed=1)
    for ids in ([], [3], [-1], [0, 0], [[0]], [0.0], [True], 0):
        with pytest.raises(ValueError, match=r"env_ids: .*expected different numbers of environments from 0 to 2"):
            batch.send(STILL[:1], ids)
    with pytest.raises(ValueError, match="actions: 3 of them, expected one for each of 1 env_ids"):
        batch.send(STILL, [1])
    with pytest.raises(ValueError, match="actions: None, expected one for each of 3 environments"):
        batch.step(None)
    for size in (0, N + 1, True):
        with pytest.raises(ValueError, match=f"batch_size: {size!r}, expected an integer from 1 to 3"):
            make_small(batch_size=size)


def test_what_is_under_way_is_named(batch: BatchEnv) -> None:
    batch.reset(seed=1)
    with pytest.raises(NoAsyncCallError, match=r"recv\(\) without send\(\)"):
        batch.recv()
    with pytest.raises(NoAsyncCallError, match=r"step_wait\(\) without step_async\(\)"):
        batch.step_wait()
    with pytest.raises(AttributeError, match="actions='goal'"):
        batch.action_masks()
    batch.send(STILL[:2], [0, 2])
    for call in (batch.reset, lambda: batch.step(STILL), lambda: batch.call("summary"), lambda: batch.send(STILL)):
        with pytest.raises(AlreadyPendingCallError, match=r"environments \[0, 2\] are under way: recv\(\) them first"):
            call()
    with pytest.raises(AlreadyPendingCallError, match=r"async_reset\(\) while environments \[0, 2\]"):
        batch.async_reset()
    batch.recv()
    batch.step_async(STILL)
    for call in (batch.recv, batch.reset, lambda: batch.send(STILL), lambda: batch.step(STILL)):
        with pytest.raises(AlreadyPendingCallError, match=r"while step\(\) is under way"):
            call()
    assert batch.step_wait()[4]["period"].tolist() == [2, 1, 2]


def test_what_was_never_reset_or_is_over_must_be_reset() -> None:
    venv = make_small(max_steps=1, autoreset_mode="Disabled")
    with pytest.raises(ResetNeeded, match=r"send\(\) before reset\(\) of the environments \[1\]"):
        venv.send(STILL[:1], [1])
    venv.reset(seed=1)
    venv.send(STILL[:2], [0, 1])
    assert venv.recv()[3].all()
    venv.send(STILL[:1], [2])
    venv.recv()
    for call in (venv.send, venv.step):
        with pytest.raises(ResetNeeded, match=r"\[0, 1, 2\]"):
            call(STILL)
    venv.close()
    for call in (venv.recv, lambda: venv.send(STILL), lambda: venv.step(STILL)):
        with pytest.raises(ClosedEnvironmentError):
            call()


class Unsendable(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Has something in its info that cannot be sent."""

    def step(self, action: Any) -> Any:
        *row, info = super().step(action)
        return *row, info | {"function": lambda: None}


def test_an_info_that_cannot_be_sent_closes_the_batch() -> None:
    venv = started(wrappers=(Unsendable,))
    pids = venv.pids
    venv.send(STILL)
    with pytest.raises(Exception, match="pickle"):
        venv.recv()
    assert venv.closed
    assert gone_within(pids, 5.0)


@pytest.fixture(params=[1, 2], ids=["alone", "with a worker"])
def own(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The number of cores that a batch counts: it steps all environments itself, or a slice of them beside a worker."""
    monkeypatch.setattr(batching, "cores", lambda: request.param)
    return request.param


def test_send_and_recv_give_each_environment_the_same_whoever_steps_it_and_whatever_is_served_first(own: int) -> None:
    fields: dict[str, Any] = {"max_steps": 5, "autoreset_mode": "SameStep"}
    found = histories(make_small(workers=None, batch_size=2, **fields), 8)
    assert any(row[3] for rows in found for row in rows)  # episodes end on the way
    for size in (1, N):
        assert same(found, histories(make_small(batch_size=size, **fields), 8))


def test_goals_have_processes_only_unless_there_is_one_environment(own: int) -> None:
    for count, workers, processes in ((N, None, min(N, 2 * own)), (1, None, 0), (N, 1, 1)):
        venv = make_small(count, workers=workers, actions="goal")
        assert len(venv.pids) == processes
        with pytest.raises(ResetNeeded, match="action_masks"):
            venv.action_masks()
        observation, _ = venv.reset(seed=1)
        assert np.array_equal(venv.action_masks([count - 1]), observation["goals"][-1:, :, 8] == 1.0)


@pytest.mark.parametrize("bad", [0, 2])
def test_an_exception_keeps_its_type_and_the_batch_goes_on_after_a_reset(own: int, bad: int) -> None:
    venv = make_small(workers=None)
    first = venv.reset(seed=1)[0]
    actions = STILL.copy()
    actions[bad] = 0.3, np.nan
    with pytest.raises(ActionError, match=r"action\[turn\]: nan") as caught:
        venv.step(actions)
    assert f"in environment {bad} of the batch" in caught.value.__notes__[0]
    assert "check_velocity" in caught.value.__notes__[0] or own == 1  # the traceback of the worker
    with pytest.raises(ResetNeeded):
        venv.step(STILL)
    assert same(venv.reset(seed=1)[0], first)
    venv.send(actions)
    with pytest.raises(ActionError, match="nan"):
        venv.recv()
    assert venv.recv()[-1]["env_id"].tolist() == [env for env in range(N) if env != bad]


@needs_linux
def test_closing_closes_the_environments_and_ends_the_workers(own: int) -> None:
    venv = make_small(workers=None, wrappers=(Counted,))
    pids, before = venv.pids, len(CLOSED)
    venv.reset(seed=1)
    venv.step_async(STILL)
    venv.close()
    venv.close()
    assert len(CLOSED) - before == (N if own == 1 else 1)  # those that this process steps
    assert gone_within(pids, 5.0)
    with pytest.raises(ClosedEnvironmentError):
        venv.step(STILL)


CLOSED: list[Any] = []


class Counted(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Notes that it is closed."""

    def close(self) -> None:
        CLOSED.append(self)
        super().close()


def test_actions_may_be_overwritten_once_they_are_sent(own: int) -> None:
    rows = []
    for later in (0.5, -0.5):
        venv = started(workers=None)
        actions = STILL + np.float32(0.5)
        venv.step_async(actions)
        actions[:] = later
        rows.append(venv.step_wait())
    assert same(*rows)


class Interrupted(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Ctrl-C comes where an action turns to the right."""

    def step(self, action: Any) -> Any:
        if action[1] < 0.0:
            raise KeyboardInterrupt
        return super().step(action)


def test_after_an_interrupted_step_the_batch_must_be_reset(own: int) -> None:
    venv = started(workers=None, wrappers=(Interrupted,))
    venv.step_async(STILL - np.float32([[0.0, 0.5], [0.0, 0.0], [0.0, 0.0]]))
    with pytest.raises(KeyboardInterrupt):
        venv.step_wait()
    with pytest.raises(WorkerError, match="interrupted"):
        venv.step_wait()
    with pytest.raises(ResetNeeded):
        venv.step(STILL)
    venv.reset(seed=1)
    assert venv.step(STILL)[-1]["period"].tolist() == [1] * N
