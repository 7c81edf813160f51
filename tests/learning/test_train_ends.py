"""Early ends of a training: Ctrl-C, a dead process, a closed pipe, another training."""

import errno
import json
import multiprocessing
import os
import shutil
import signal
from functools import partial
from itertools import islice

import gymnasium as gym
import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("sb3_contrib")
pytest.importorskip("safetensors")

from stable_baselines3.common.save_util import load_from_zip_file, save_to_zip_file  # noqa: E402

from mecp_env.core.processes import cores  # noqa: E402
from mecp_env.core.work_units import FailedUnit  # noqa: E402
from mecp_env.learning import train  # noqa: E402
from mecp_env.learning.environments import vectorise  # noqa: E402
from mecp_env.learning.run_folder import RunFolder, Table, lock, read_rows  # noqa: E402
from mecp_env.vector import WorkerDied  # noqa: E402
from tests.learning.test_learned import Payload  # noqa: E402
from tests.learning.training import QUICK, checkpoints, quick, resume, run  # noqa: E402


@pytest.mark.parametrize(
    ("place", "error", "code", "said"),
    [
        ((train, "train"), KeyboardInterrupt(), 130, "mecp-env: interrupted\n"),
        ((train, "train"), BrokenPipeError(32, "Broken pipe"), 1, "Broken pipe"),
        ((train, "learn"), WorkerDied("worker 0 was killed by SIGKILL"), 1, "killed by SIGKILL"),
        ((RunFolder, "save"), OSError(errno.ENOSPC, "No space left", "run/x"), 1, "mecp-env: run/x: No space left\n"),
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


@pytest.mark.parametrize("place", ["teach", "gradient_step"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_in_a_warm_start_ends_it_and_keeps_nothing_of_it(place, number, tmp_path, capsys, monkeypatch):
    """While the teacher plays, and while its lesson is learned: a resumed run starts the warm start again."""
    plain = getattr(train, place)

    def pressed(*given):
        signal.raise_signal(number)
        return plain(*given)

    monkeypatch.setattr(train, place, pressed)
    folder, code = run(tmp_path, warm_start={"teacher": "bfs", "decisions": 16, "epochs": 2})
    assert code == 130
    assert "an interrupted warm start starts again" in capsys.readouterr().out.replace("\n", " ")
    assert not checkpoints(folder)
    assert not (folder / "policy.json").exists()


def test_lessons_come_in_order_and_an_episode_of_the_teacher_that_fails_is_named(monkeypatch):
    def lessons(*results):
        monkeypatch.setattr(train, "run_units", lambda *_: (yield from results))
        return list(train.episodes(quick(workers="batch", warm_start={"teacher": "bfs"})))

    assert train.discounted_returns([(0, 1.0, 0.5), (0, 2.0, 0.9)]).tolist() == [2.0, 2.0]
    assert lessons((1, "b"), (0, "a"), (3, "d"), (2, "c"), (5, "f")) == [*"abcd"]
    died = WorkerDied("its process was killed by SIGKILL")
    with pytest.raises(WorkerDied, match="warm start, episode 3: its process was killed by SIGKILL"):
        lessons((3, FailedUnit(3, str(died), died)))


@pytest.mark.slow
def test_lessons_of_processes_are_those_of_one_process():
    config = quick(warm_start={"teacher": "bfs"})
    many = config.model_copy(update={"workers": "batch"})
    here, there = (list(islice(train.episodes(c), 3)) for c in (config, many))
    for mine, yours in zip(here, there, strict=True):
        assert mine.keys() == yours.keys()
        assert all(mine[name].tobytes() == yours[name].tobytes() for name in mine)


def test_the_processes_of_environments_and_one_that_dies():
    """Seen: a step waited forever or ended in a bare EOFError, and so did `close`."""
    makers = [partial(gym.make, "CartPole-v1")] * 2
    learner = vectorise(makers, computing=True)  # this process steps none itself
    assert len(learner.batch.pids) == min(2, cores())
    learner.close()
    pair = vectorise(makers, "processes")
    pair.reset()
    os.kill(pair.batch.pids[1], signal.SIGKILL)
    with pytest.raises(WorkerDied, match=r"environments 1 to 1\) was killed by SIGKILL"):
        pair.step(np.array([0, 0]))
    pair.close()


def test_a_reader_that_goes_does_not_end_the_run(tmp_path, monkeypatch):
    """Seen: `train ... | head -1` ended early with exit code 0."""
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w", buffering=1) as output:
        monkeypatch.setattr("sys.stdout", output)
        folder, code = run(tmp_path, steps=12)
    assert code == 0
    assert [path.stem for path in checkpoints(folder)][-1] == "000000000012"


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The folder of a run that wrote four checkpoints and kept three."""
    folder, _ = run(tmp_path_factory.mktemp("trained"), steps=36)
    assert [int(path.stem) for path in checkpoints(folder)] == [12, 24, 36]
    assert not list((folder / "checkpoints").glob(".*"))
    return folder


@pytest.fixture
def copy(trained, tmp_path):
    """A copy of it."""
    return shutil.copytree(trained, tmp_path / "run")


def hold(pipe, *folders):
    """Lock folders until the process is killed."""
    locks = [lock(folder / ".lock") for folder in folders]
    pipe.send(len(locks))
    pipe.recv()


def test_a_folder_that_another_process_holds_is_refused_until_that_has_gone(copy, tmp_path, capsys):
    """Seen: without the lock at the start, two processes trained in one folder."""
    new = tmp_path / "new" / "run"
    new.mkdir(parents=True)
    ours, theirs = multiprocessing.Pipe()
    other = multiprocessing.get_context("fork").Process(target=hold, args=(theirs, copy, new))
    other.start()
    assert ours.recv() == 2
    assert (resume(copy), run(tmp_path / "new")[1]) == (2, 2)
    assert capsys.readouterr().err.count("is being trained by another process") == 2
    assert [path.name for path in new.iterdir()] == [".lock"]
    other.kill()
    other.join()
    RunFolder(copy, quick()).hold()


def flipped(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


CHANGES = {
    "text for a number": {"state": {"decisions": "36"}},
    "an unknown field": {"state": {"decision": 36}},
    "a list": {"state": [1]},
    "weights of another shape": {"policy": {"log_std": torch.zeros(3)}},
    "one bit": flipped,
    "half of the file": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "killed while it was written": lambda path: path.rename(path.with_name(".x.tmp")),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_damaged_or_tampered_checkpoint_is_skipped_with_its_reason(name, copy, capsys):
    path, change = copy / "checkpoints" / "000000000036.zip", CHANGES[name]
    if callable(change):
        change(path)
    else:
        parts = load_from_zip_file(path, load_data=False)[1]
        (key, part), *_ = change.items()
        save_to_zip_file(path, params=parts | {key: parts[key] | part if isinstance(part, dict) else part})
    there = path.exists()
    assert resume(copy) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert ("skipped " in out) == there
    assert "resumed after 24 decisions" in out


def test_a_checkpoint_that_would_run_code_is_skipped(copy, tmp_path, capsys):
    path, mark = copy / "checkpoints" / "000000000036.zip", tmp_path / "it_ran"
    save_to_zip_file(path, params=load_from_zip_file(path, load_data=False)[1] | {"state": Payload(mark)})
    assert resume(copy) == 0
    assert "resumed after 24 decisions" in capsys.readouterr().out
    assert not mark.exists()


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
    (copy / "config.json").write_text(fields)
    for path in checkpoints(copy):
        path.write_bytes(b"damaged")
    assert resume(copy) == 2
    assert "damaged, or not a checkpoint" in capsys.readouterr().err


def test_a_run_that_made_a_few_decisions_more_than_its_steps_may_be_resumed(tmp_path, capsys):
    folder, _ = run(tmp_path, steps=10, log=QUICK["log"] | {"evaluate_buildings": 2})
    assert "+-" in capsys.readouterr().out  # the error of a mean over two buildings
    assert int(checkpoints(folder)[-1].stem) == 12
    (folder / "checkpoints" / "9x.zip").write_bytes(b"of another program")
    assert resume(folder, "--steps", "10") == 0


def test_a_table_continues_after_the_rows_of_the_checkpoint(tmp_path):
    path, columns = tmp_path / "table.csv", ("decisions", "auc", "n")
    table = Table(path, columns, 0)
    for decisions in (1, 2, 3):
        table.write({"time/decisions": decisions, "rollout/auc": 0.5, "time/fps": 3}, {}, decisions)
    table.close()
    again = Table(path, columns, 2)
    again.write({"time/decisions": 3, "rollout/auc": 0.25}, {}, 3)
    again.close()
    assert path.read_text() == "decisions,auc,n\n1,0.5,\n2,0.5,\n3,0.25,\n"
    assert [row["auc"] for row in read_rows(path)] == ["0.5", "0.5", "0.25"]
