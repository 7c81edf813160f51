"""Units of work: what fails is named, what is finished is kept, and shards and resumed runs give the same bytes."""

import json
import math
import multiprocessing
import os
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mecp_env.core.errors import ConfigError
from mecp_env.core.processes import WorkerDied
from mecp_env.core.work_units import FailedUnit, KeptResults, Shard, run_kept, run_units
from tests.processes import needs_linux

RUN = {"setting": "easy", "code": "ab12"}
Figures = dict[str, float]


def root(unit: int) -> float:
    """The task of most tests; some units go wrong."""
    if unit == -1:
        os.kill(os.getpid(), signal.SIGKILL)
    return math.sqrt(abs(unit)) if unit != -2 else math.sqrt(unit)


def wait_in_worker(unit: int) -> int:
    time.sleep(60.0 * (unit > 0))
    return unit


def figures(seed: int) -> Figures:
    """A result whose every bit counts."""
    x = np.random.default_rng(seed).normal(size=3)
    return {"mean": x.mean(), "nan": math.nan, "inf": -math.inf, "tiny": 5e-324, "third": x[0] / 3}


@needs_linux
def test_what_fails_is_named_with_its_unit_and_the_others_finish() -> None:
    results = dict(run_units(root, [4, -2, 9, -1, 16], 2))
    assert [results[number] for number in (0, 2, 4)] == [2.0, 3.0, 4.0]
    assert str(results[1]).startswith("-2: ValueError: ")
    assert str(results[3]) == "-1: its process was killed by SIGKILL"
    assert [type(results[number].error) for number in (1, 3)] == [ValueError, WorkerDied]
    assert list(run_units(root, [], 2)) == []
    assert not multiprocessing.active_children()


def test_the_processes_end_with_the_generator_whatever_they_do() -> None:
    results = run_units(wait_in_worker, [0, 1, 2, 3], 2)
    assert next(results) == (0, 0)
    assert len(multiprocessing.active_children()) == 2
    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        results.throw(KeyboardInterrupt)
    assert time.monotonic() - start < 4.0
    assert not multiprocessing.active_children()


@pytest.mark.parametrize("text", ["3/2", "0/2", "1", "1/2/3", "9" * 5000 + "/2"])
def test_a_wrong_shard_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="expected NUMBER/COUNT such as 1/4, with 1 <= NUMBER <= COUNT"):
        Shard.parse(text)


def kept_bytes(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def run(folder: Path, seeds: Any = range(6), jobs: int = 1, task: Callable[[int], Figures] = figures) -> str:
    """The text of all results of a run in a folder, by unit."""
    kept = KeptResults(folder, Figures, RUN)
    return json.dumps(dict(run_kept(task, {f"seed {seed}": seed for seed in seeds}, kept, jobs)), sort_keys=True)


def test_shards_and_processes_give_the_bytes_of_a_single_run(tmp_path: Path) -> None:
    single = run(tmp_path / "single")
    for number in (2, 3, 1):
        run(tmp_path / str(number), Shard(number, 3).part(range(6)), jobs=number)
        shutil.copytree(tmp_path / str(number), tmp_path / "shards", dirs_exist_ok=True)
    before = kept_bytes(tmp_path / "shards")
    assert before == kept_bytes(tmp_path / "single")
    assert run(tmp_path / "shards") == single
    assert kept_bytes(tmp_path / "shards") == before
    assert json.loads(single)["seed 3"]["tiny"] == 5e-324
    assert math.isnan(json.loads(single)["seed 3"]["nan"])


SEEDS = 15


def slow_figures(seed: int) -> Figures:
    time.sleep(0.1)
    return figures(seed)


def start_slow(folder: Path) -> Any:
    """A process that fills a folder with results."""
    process = multiprocessing.get_context("spawn").Process(target=run, args=(folder, range(SEEDS), 1, slow_figures))
    process.start()
    return process


def test_runs_that_are_killed_or_share_a_folder_give_the_same_bytes(tmp_path: Path) -> None:
    single, folder = run(tmp_path / "single", range(SEEDS)), tmp_path / "both"
    killed, other = start_slow(folder), start_slow(folder)
    while not folder.is_dir() or len(list(folder.glob("[!.]*"))) < 3:
        time.sleep(0.01)
    killed.kill()
    killed.join()
    assert 3 <= len(list(folder.glob("[!.]*.json"))) < SEEDS
    other.join(60)
    assert other.exitcode == 0
    next(folder.glob("seed_7-*")).unlink()
    assert run(folder, range(SEEDS)) == single
    written = {name: data for name, data in kept_bytes(folder).items() if not name.startswith(".")}
    assert written == kept_bytes(tmp_path / "single")


def test_other_files_are_left_alone_and_another_run_is_refused_with_what_differs(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / ".x.json.7.tmp").write_text("{")  # of a killed process
    slower, faster = (KeptResults(tmp_path, float, RUN) for _ in range(2))
    assert faster.keep("x", 1.0) == 1.0
    assert slower.keep("x", 2.0) == 1.0
    assert KeptResults(tmp_path, float, RUN).found == {"x": 1.0}
    with pytest.raises(ConfigError) as caught:
        KeptResults(tmp_path, float, {"setting": "hard", "code": "ab12", "more": 1})
    assert str(caught.value) == (
        f"{tmp_path} has results of another run: setting 'easy', more None; this one has setting 'hard', more 1; "
        "choose another folder, or remove that one"
    )
    assert len(list(tmp_path.iterdir())) == 3


def changed(**fields: Any) -> Callable[[bytes], bytes]:
    """A file with other fields, or without those that are None."""

    def change(data: bytes) -> bytes:
        given = json.loads(data) | fields
        return json.dumps({name: value for name, value in given.items() if value is not None}).encode()

    return change


DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "cut": lambda data: data[:-20],
    "a list": lambda data: b"[1]",
    "another program": changed(format="other"),
    "no run": changed(run=None),
    "no result": changed(result=None),
    "another number": lambda data: data.replace(b"1.0", b"1.5"),
    "another result": changed(result="none"),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_file_is_one_error_and_stays_as_it_is(damage: str, tmp_path: Path) -> None:
    KeptResults(tmp_path, float, RUN).keep("x", 1.0)
    (path,) = tmp_path.iterdir()
    whole = path.read_bytes()
    before = DAMAGE[damage](whole)
    path.write_bytes(before)
    with pytest.raises(ConfigError, match=r"x-[0-9a-f]{16}\.json: damaged, or no result of mecp_env") as caught:
        KeptResults(tmp_path, float, RUN)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400
    assert path.read_bytes() == before != whole
    path.write_bytes(changed(version=2)(whole))
    with pytest.raises(ConfigError, match=r"\.json: version 2, this mecp_env reads version 1"):
        KeptResults(tmp_path, float, RUN)


@pytest.mark.parametrize("name", ["../../x", "x" * 300, "", "a\nb"])
def test_any_name_of_a_unit_is_a_file_in_the_folder(name: str, tmp_path: Path) -> None:
    KeptResults(tmp_path / "kept", float, RUN).keep(name, 1.0)
    assert len(list((tmp_path / "kept").iterdir())) == 1
    assert KeptResults(tmp_path / "kept", float, RUN).found == {name: 1.0}


def test_a_failed_unit_is_not_kept_and_is_run_again(tmp_path: Path) -> None:
    kept, units = KeptResults(tmp_path, float, RUN), {"good": 4, "bad": -2}
    results = dict(run_kept(root, units, kept, 1))
    assert (results["good"], type(results["bad"])) == (2.0, FailedUnit)
    assert "(root, line " in str(results["bad"])
    assert len(list(tmp_path.iterdir())) == 1
    assert dict(run_kept(abs, units, kept, 1)) == {"good": 2.0, "bad": 2.0}  # the other task runs for the failed unit
