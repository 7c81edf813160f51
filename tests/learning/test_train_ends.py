"""Early ends of a training and how it goes on: Ctrl-C, a dead process, a closed pipe, damaged checkpoints."""

import errno
import json
import shutil
from functools import partial

import gymnasium as gym
import pytest
import torch
from stable_baselines3.common.save_util import load_from_zip_file, save_to_zip_file

from mecp_env.core.processes import cores
from mecp_env.learning import train
from mecp_env.learning.environments import vectorise
from mecp_env.vector import WorkerDied
from tests.cli.pipes import closed_pipe
from tests.learning.test_learned import Payload
from tests.learning.training import QUICK, flipped, made_in, resume, run, weights_in


@pytest.mark.parametrize(
    ("place", "error", "code", "said"),
    [
        ((train, "train"), KeyboardInterrupt(), 130, "mecp-env: interrupted\n"),
        ((train, "train"), BrokenPipeError(32, "Broken pipe"), 1, "Broken pipe"),
        ((train.Run, "learn"), WorkerDied("worker 0 was killed by SIGKILL"), 1, "killed by SIGKILL"),
        ((train.Run, "save"), OSError(errno.ENOSPC, "No space left", "run/x"), 1, "mecp-env: run/x: No space left\n"),
    ],
    ids=["Ctrl-C outside the training", "broken pipe from elsewhere", "killed worker", "full disk"],
)
def test_what_ends_a_run_is_one_line(place, error, code, said, tmp_path, capsys, monkeypatch):
    def fails(*_, **__):
        raise error

    monkeypatch.setattr(*place, fails)
    folder, found = run(tmp_path, steps=12)
    printed = capsys.readouterr()
    assert found == code
    assert said in printed.err
    assert printed.err.count("\n") == 1
    assert place[1] != "learn" or f"mecp-env train --resume {folder}\n" in printed.out


def test_a_process_that_computes_steps_no_environment_itself():
    learner = vectorise([partial(gym.make, "CartPole-v1")] * 2, computing=True)
    assert len(learner.batch.pids) == min(2, cores())
    learner.close()


def test_a_reader_that_goes_does_not_end_the_run(tmp_path):
    """Seen: `train ... | head -1` ended early with exit code 0."""
    with closed_pipe():
        folder, code = run(tmp_path, steps=12)
    assert code == 0
    assert made_in(folder)[-1] == 12


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The folder of a run that wrote four checkpoints and kept three."""
    folder, _ = run(tmp_path_factory.mktemp("trained"), steps=36)
    assert made_in(folder) == [12, 24, 36]
    assert not list((folder / "checkpoints").glob(".*"))
    return folder


@pytest.fixture
def copy(trained, tmp_path):
    """A copy of it."""
    return shutil.copytree(trained, tmp_path / "run")


CHANGES = {
    "text for a number": {"state": {"decisions": "36"}},
    "weights of another shape": {"policy": {"log_std": torch.zeros(3)}},
    "code": {},
    "one bit": flipped,
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_damaged_or_tampered_checkpoint_is_refused_and_the_one_before_can_be_taken(name, copy, tmp_path, capsys):
    path, mark, change = copy / "checkpoints" / "000000000036.zip", tmp_path / "it_ran", CHANGES[name]
    if callable(change):
        change(path)
    else:
        parts = load_from_zip_file(path, load_data=False)[1]
        (key, part), *_ = change.items() if change else [("state", Payload(mark))]
        save_to_zip_file(path, params=parts | {key: parts[key] | part if isinstance(part, dict) else part})
    before = (copy / "run.json").read_bytes()
    assert resume(copy) == 2
    assert f"{path}: damaged, or not a checkpoint (" in capsys.readouterr().err
    assert (copy / "run.json").read_bytes() == before
    assert not mark.exists()
    path.unlink()
    if change is flipped:
        assert resume(copy) == 0
        assert "resumed after 24 decisions" in capsys.readouterr().out


def test_a_finished_run_that_is_resumed_stays_as_it_is(copy, capsys):
    """Seen: resumed for 10 it printed "48/10 ... done" and kept 10 in its configuration."""
    before = {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()}
    assert resume(copy, "--steps", "10") == 2
    assert capsys.readouterr().err == f"mecp-env: steps: 10, but the run in {copy} has made 36 decisions already\n"
    assert {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()} == before
    assert resume(copy) == 0
    assert (copy / "evaluation.csv").read_bytes() == before[copy / "evaluation.csv"]  # not evaluated again


def test_a_folder_in_which_other_files_are_damaged(copy, capsys):
    for name in ("progress.csv", "evaluation.csv"):
        with (copy / name).open("a") as table:
            table.write("a lot,of,text\n")
    (copy / "run.json").write_text("{")
    assert resume(copy) == 0
    fields = (copy / "config.json").read_text()
    (copy / "config.json").write_text(json.dumps(json.loads(fields) | {"sed": 3}))
    assert resume(copy) == 2
    assert "did you mean 'seed'" in capsys.readouterr().err


def test_a_run_that_made_a_few_decisions_more_than_its_steps_may_be_resumed(tmp_path, capsys):
    folder, _ = run(tmp_path, steps=10, log=QUICK["log"] | {"evaluate_buildings": 2})
    assert "+-" in capsys.readouterr().out  # the error of a mean over two buildings
    assert made_in(folder)[-1] == 12
    (folder / "checkpoints" / "9x.zip").write_bytes(b"of another program")
    assert resume(folder, "--steps", "10") == 0


def test_a_table_continues_after_the_rows_of_the_checkpoint(tmp_path):
    path, columns = tmp_path / "table.csv", ("decisions", "auc", "n")
    table = train.Table(path, columns, 0)
    for decisions in (1, 2, 3):
        table.write({"time/decisions": decisions, "rollout/auc": 0.5, "time/fps": 3}, {}, decisions)
    table.close()
    again = train.Table(path, columns, 2)
    again.write({"time/decisions": 3, "rollout/auc": 0.25}, {}, 3)
    again.close()
    assert path.read_text() == "decisions,auc,n\n1,0.5,\n2,0.5,\n3,0.25,\n"


@pytest.mark.slow
def test_two_runs_that_continue_from_a_checkpoint_learn_the_same(tmp_path):
    folder, _ = run(tmp_path, workers="batch", steps=12)
    weights = []
    for name in ("a", "b"):
        shutil.copytree(folder, tmp_path / name)
        assert resume(tmp_path / name, "--steps", "24") == 0
        assert made_in(tmp_path / name)[-1] == 24
        weights.append(weights_in(tmp_path / name))
    assert all(torch.equal(weights[0][key], weights[1][key]) for key in weights[0])
