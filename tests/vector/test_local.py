"""A batch whose calling process steps environments itself: all of them, or the first slice beside its workers."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, ResetNeeded

from mecp_env.core.errors import ActionError
from mecp_env.core.processes import WorkerError
from mecp_env.vector import batch as batching
from tests.env.helpers import same
from tests.processes import gone_within, needs_linux
from tests.vector.helpers import N, make_small
from tests.vector.test_async import histories

STILL = np.zeros((N, 2), np.float32)
CORES = [1, 2]  # all here; one slice here, the other in a worker


@pytest.fixture(params=CORES, ids=["alone", "with a worker"])
def own(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    """The number of cores that a batch counts."""
    cores: int = request.param
    monkeypatch.setattr(batching, "cores", lambda: cores)
    return cores


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
        assert np.array_equal(venv.action_masks([0]), observation["goals"][:1, :, 8] == 1.0)


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
        venv = make_small(workers=None)
        venv.reset(seed=1)
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
    venv = make_small(workers=None, wrappers=(Interrupted,))
    venv.reset(seed=1)
    venv.step_async(STILL - np.float32([[0.0, 0.5], [0.0, 0.0], [0.0, 0.0]]))
    with pytest.raises(KeyboardInterrupt):
        venv.step_wait()
    with pytest.raises(WorkerError, match="interrupted"):
        venv.step_wait()
    with pytest.raises(ResetNeeded):
        venv.step(STILL)
    venv.reset(seed=1)
    assert venv.step(STILL)[-1]["period"].tolist() == [1] * N
