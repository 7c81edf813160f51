"""Early ends of a training: Ctrl-C, a dead process, a closed pipe, another training."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from functools import partial
from itertools import count, islice

import gymnasium as gym
import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("sb3_contrib")
pytest.importorskip("safetensors")

from stable_baselines3.common.save_util import load_from_zip_file, save_to_zip_file  # noqa: E402

from mecp_env.core.processes import cores  # noqa: E402
from mecp_env.core.work_units import FailedUnit  # noqa: E402
from mecp_env.learning import train, warm_start  # noqa: E402
from mecp_env.learning.environments import vectorise  # noqa: E402
from mecp_env.learning.run_folder import RunFolder  # noqa: E402
from mecp_env.learning.run_log import Table, read_rows  # noqa: E402
from mecp_env.vector import WorkerDied  # noqa: E402
from tests.learning.test_learned import Payload  # noqa: E402
from tests.learning.training import QUICK, ROOT, checkpoints, quick, resume, run  # noqa: E402
from tests.processes import gone_within  # noqa: E402


def test_ctrl_c_outside_the_training_is_one_line(tmp_path, capsys, monkeypatch):
    def interrupted(config, folder, resume):
        raise KeyboardInterrupt

    monkeypatch.setattr(train, "train", interrupted)
    assert run(tmp_path)[1] == 130
    assert capsys.readouterr().err == "mecp-env: interrupted\n"


@pytest.mark.parametrize("after", [1, 3])
def test_ctrl_c_in_a_warm_start_ends_it_and_keeps_nothing_of_it(after, tmp_path, capsys, monkeypatch):
    """While the teacher plays, and between two epochs: a resumed run starts the warm start again."""
    asked, plain = count(), warm_start.warm_start

    def stopped(model, venv, config, log, stop):
        def pressed():
            if next(asked) == after:
                signal.raise_signal(signal.SIGINT)
            return stop()

        return plain(model, venv, config, log, pressed)

    monkeypatch.setattr(train, "warm_start", stopped)
    folder, code = run(tmp_path, warm_start={"teacher": "bfs", "decisions": 16, "epochs": 2})
    said = capsys.readouterr().out.replace("\n", " ")
    assert code == 130
    assert "an interrupted warm start starts again" in said
    assert not checkpoints(folder)
    assert not (folder / "policy.json").exists()


def finished_by(results):
    """Stands for `run_units`: these results, as they are finished."""

    def run_units(task, units, jobs, stop):
        yield from results

    return run_units


def test_lessons_come_in_order_whatever_is_finished_first(monkeypatch):
    monkeypatch.setattr(warm_start, "run_units", finished_by([(1, "b"), (0, "a"), (3, "d"), (2, "c"), (5, "f")]))
    assert list(warm_start.episodes(quick(workers="batch", warm_start={"teacher": "bfs"}), lambda: False)) == [*"abcd"]


def test_an_episode_of_the_teacher_that_fails_is_named(monkeypatch):
    failed = FailedUnit(3, "its process was killed by SIGKILL", WorkerDied("its process was killed by SIGKILL"))
    monkeypatch.setattr(warm_start, "run_units", finished_by([(3, failed)]))
    with pytest.raises(WorkerDied, match="warm start, episode 3: its process was killed by SIGKILL"):
        list(warm_start.episodes(quick(workers="batch", warm_start={"teacher": "bfs"}), lambda: False))


@pytest.mark.slow
def test_lessons_of_processes_are_those_of_one_process():
    config = quick(warm_start={"teacher": "bfs"})
    many = config.model_copy(update={"workers": "batch"})
    here, there = (list(islice(warm_start.episodes(c, lambda: False), 3)) for c in (config, many))
    for mine, yours in zip(here, there, strict=True):
        assert mine.keys() == yours.keys()
        assert all(mine[name].tobytes() == yours[name].tobytes() for name in mine)


@pytest.fixture
def pair():
    venv = vectorise([partial(gym.make, "CartPole-v1")] * 2, "processes")
    venv.reset()
    yield venv
    venv.close()


def test_the_process_of_an_environment_that_dies_is_named_and_nobody_waits(pair):
    """Seen: a step waited forever or ended in a bare EOFError, and so did `close`."""
    pids = pair.batch.pids
    assert len(pids) == 2
    os.kill(pids[1], signal.SIGKILL)
    begun = time.monotonic()
    with pytest.raises(WorkerDied, match=r"environments 1 to 1\) was killed by SIGKILL"):
        pair.step(np.array([0, 0]))
    pair.close()
    assert time.monotonic() - begun < 5.0
    assert gone_within(pids, 1.0)


def test_processes_interrupted_in_a_step_are_closed_at_once(pair):
    pids = pair.batch.pids
    pair.step_async(np.array([0, 0]))
    pair.close()
    assert gone_within(pids, 1.0)


def test_a_reader_that_goes_does_not_end_the_run(tmp_path, capsys, monkeypatch):
    """Seen: `train ... | head -1` ended early with exit code 0."""
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w", buffering=1) as output:
        monkeypatch.setattr("sys.stdout", output)
        folder, code = run(tmp_path, steps=12)
    assert code == 0
    assert capsys.readouterr().err.count("the output pipe is closed") == 1
    assert [path.stem for path in checkpoints(folder)][-1] == "000000000012"


def test_a_broken_pipe_from_elsewhere_is_a_failure(tmp_path, capsys, monkeypatch):
    def broken(config, folder, resume):
        raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.setattr(train, "train", broken)
    assert run(tmp_path)[1] == 1
    assert "Broken pipe" in capsys.readouterr().err


HOLD = "import sys; from pathlib import Path; from mecp_env.learning.run_folder import lock; "
HOLD += "held = lock(Path(sys.argv[1])); print('held', flush=True); input()"


@pytest.mark.slow
def test_a_folder_that_another_process_trains_in_is_refused_until_that_has_gone(tmp_path, capsys):
    folder, _ = run(tmp_path, steps=12)
    words = [sys.executable, "-c", HOLD, str(folder / ".lock")]
    other = subprocess.Popen(words, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert other.stdout.readline() == "held\n"
    assert resume(folder) == 2
    assert "is being trained by another process" in capsys.readouterr().err
    other.kill()
    other.communicate()
    RunFolder(folder, quick()).hold()


def test_a_new_run_in_a_folder_that_another_process_holds_writes_nothing(tmp_path, capsys):
    """Seen: without the lock at the start, two processes trained in one folder."""
    folder = tmp_path / "run"
    folder.mkdir()
    words = [sys.executable, "-c", HOLD, str(folder / ".lock")]
    other = subprocess.Popen(words, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert other.stdout.readline() == "held\n"
    assert run(tmp_path)[1] == 2
    assert "is being trained by another process" in capsys.readouterr().err
    assert [path.name for path in folder.iterdir()] == [".lock"]
    other.kill()
    other.communicate()


def test_a_full_disk_ends_the_run_with_one_line(tmp_path, capsys, monkeypatch):
    def full(self, model, state):
        raise OSError(errno.ENOSPC, "No space left on device", str(self.folder / "checkpoints"))

    monkeypatch.setattr(RunFolder, "save", full)
    folder, code = run(tmp_path, steps=12)
    assert code == 1
    assert capsys.readouterr().err == f"mecp-env: {folder / 'checkpoints'}: No space left on device\n"


def parts_of(checkpoint):
    """What is in a checkpoint."""
    return load_from_zip_file(checkpoint, load_data=False)[1]


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The folder of a run with three checkpoints."""
    return run(tmp_path_factory.mktemp("trained"), steps=24)[0]


@pytest.mark.parametrize("written", [0.0, 0.5, 0.999])
def test_a_kill_while_a_checkpoint_is_written_leaves_the_one_before(written, trained, tmp_path, capsys):
    """A checkpoint is written to a temporary file; a part of one under its own name is skipped, too."""
    folder = shutil.copytree(trained, tmp_path / "run")
    newest = folder / "checkpoints" / "000000000024.zip"
    data = newest.read_bytes()
    newest.rename(folder / "checkpoints" / ".x.tmp")
    if written:
        newest.write_bytes(data[: int(written * len(data))])
    assert resume(folder) == 0
    assert "resumed after 12 decisions" in capsys.readouterr().out


@pytest.mark.parametrize(
    "change",
    [
        {"state": {"decisions": "24"}},
        {"state": {"decision": 24}},
        {"state": [1]},
        {"policy": {"log_std": torch.zeros(3)}},
        {"policy": 3},
        {"other": {}},
    ],
    ids=str,
)
def test_a_tampered_checkpoint_is_skipped_with_its_reason(change, trained, tmp_path, capsys):
    folder = shutil.copytree(trained, tmp_path / "run")
    path = folder / "checkpoints" / "000000000024.zip"
    parts = parts_of(path)
    for name, part in change.items():
        parts[name] = parts[name] | part if isinstance(part, dict) and name in parts else part
    save_to_zip_file(path, params=parts)
    assert resume(folder) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "skipped " in out
    assert "resumed after 12 decisions" in out


def test_a_checkpoint_that_would_run_code_is_skipped(trained, tmp_path, capsys):
    folder = shutil.copytree(trained, tmp_path / "run")
    path, mark = folder / "checkpoints" / "000000000024.zip", tmp_path / "it_ran"
    save_to_zip_file(path, params=parts_of(path) | {"state": Payload(mark)})
    assert resume(folder) == 0
    assert "resumed after 12 decisions" in capsys.readouterr().out
    assert not mark.exists()


def test_text_in_tables_does_not_end_a_resumption(trained, tmp_path):
    folder = shutil.copytree(trained, tmp_path / "run")
    for name in ("progress.csv", "evaluation.csv"):
        with (folder / name).open("a") as table:
            table.write("a lot,of,text\n")
    (folder / "run.json").write_text("{")
    assert resume(folder) == 0


def test_a_tampered_configuration_is_refused_with_a_suggestion(trained, tmp_path, capsys):
    folder = shutil.copytree(trained, tmp_path / "run")
    fields = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(fields | {"sed": 3}))
    assert resume(folder) == 2
    assert "did you mean 'seed'" in capsys.readouterr().err


def test_an_evaluation_in_one_building_is_said_without_an_error(tmp_path, capsys):
    """Seen: the error was "+- 0.0000", as if it were known exactly."""
    run(tmp_path, steps=6, log=QUICK["log"] | {"evaluate_buildings": 2})
    assert "+-" in capsys.readouterr().out
    run(tmp_path, "--out", str(tmp_path / "one"), steps=6)
    assert "+-" not in capsys.readouterr().out


def test_a_finished_run_that_is_resumed_is_not_evaluated_again(tmp_path):
    folder, _ = run(tmp_path, steps=12)
    before = (folder / "evaluation.csv").read_text()
    assert resume(folder) == 0
    assert (folder / "evaluation.csv").read_text() == before


def test_a_run_that_is_resumed_for_less_than_it_has_made_is_refused_and_stays_as_it_is(tmp_path, capsys):
    """Seen: it printed "48/10 ... done" and kept 10 in its configuration."""
    folder, _ = run(tmp_path, steps=12)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert resume(folder, "--steps", "10") == 2
    assert capsys.readouterr().err == f"mecp-env: steps: 10, but the run in {folder} has made 12 decisions already\n"
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_a_run_that_made_a_few_decisions_more_than_its_steps_may_be_resumed(tmp_path):
    folder, _ = run(tmp_path, steps=10)
    assert int(checkpoints(folder)[-1].stem) == 12
    (folder / "checkpoints" / "9x.zip").write_bytes(b"of another program")
    assert resume(folder, "--steps", "10") == 0


def test_a_run_of_which_every_checkpoint_is_damaged_is_refused(trained, tmp_path, capsys):
    folder = shutil.copytree(trained, tmp_path / "run")
    for path in checkpoints(folder):
        path.write_bytes(b"damaged")
    assert resume(folder) == 2
    assert "damaged, or not a checkpoint" in capsys.readouterr().err


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


def test_a_learner_that_computes_while_environments_step_steps_none_itself():
    venv = vectorise([partial(gym.make, "CartPole-v1")] * 2, computing=True)
    assert len(venv.batch.pids) == min(2, cores())
    venv.close()
