"""How a training ends before its time: Ctrl-C, a process that dies, a reader that goes, another training."""

from __future__ import annotations

import signal
from concurrent.futures import Future
from itertools import count

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("sb3_contrib")
pytest.importorskip("safetensors")

from agents import train  # noqa: E402
from agents.learning import warm_start  # noqa: E402
from agents.learning.checkpoints import Checkpoints  # noqa: E402
from mecp_env.vector import WorkerDied  # noqa: E402
from tests.agents.training import quick, run  # noqa: E402


def test_ctrl_c_outside_the_training_is_one_line(tmp_path, capsys, monkeypatch):
    def interrupted(order):
        raise KeyboardInterrupt

    monkeypatch.setattr(train, "train", interrupted)
    assert run(tmp_path)[1] == 130
    assert capsys.readouterr().err == "train: interrupted\n"


@pytest.mark.parametrize("after", [1, 3])
def test_ctrl_c_in_a_warm_start_ends_it_and_keeps_nothing_of_it(after, tmp_path, capsys, monkeypatch):
    """While the teacher plays, and between two epochs: a resumed run begins it anew, as if nothing had been."""
    asked, imitate = count(), warm_start.imitate

    def stopped(model, venv, config, report, stop):
        def pressed():
            if next(asked) == after:
                signal.raise_signal(signal.SIGINT)
            return stop()

        return imitate(model, venv, config, report, pressed)

    monkeypatch.setattr("agents.learning.trainer.imitate", stopped)
    folder, code = run(tmp_path, warm_start={"teacher": "bfs", "decisions": 16, "epochs": 2})
    said = capsys.readouterr().out.replace("\n", " ")
    assert code == 130
    assert "a warm start is whole or begins again" in said
    assert not Checkpoints(folder / "checkpoints", 3).paths()
    assert not (folder / "policy.json").exists()


def test_results_come_in_order_until_somebody_stops():
    work = [Future() for _ in range(5)]
    for number in (0, 1, 3):
        work[number].set_result(number)
    answers = iter([False, False, False, False, True])  # the third result never comes
    assert list(warm_start.in_order(iter(work), 3, lambda: next(answers))) == [0, 1]


def test_a_teacher_whose_process_dies_is_named(monkeypatch):
    def die(begun, ahead, stop):
        raise warm_start.BrokenProcessPool("a child process terminated abruptly")
        yield

    monkeypatch.setattr(warm_start, "in_order", die)
    with pytest.raises(WorkerDied, match="of the warm start: a child process terminated"):
        list(warm_start.episodes(quick(workers="batch", warm_start={"teacher": "bfs"}), warm_start.never))
