"""Units of work: what fails is named, what is finished is kept, and shards and resumed runs give the same bytes."""

from __future__ import annotations

import errno
import json
import math
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from itertools import count, islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mecp_env.core import files, work_units
from mecp_env.core.errors import ConfigError
from mecp_env.core.processes import WorkerDied
from mecp_env.core.work_units import WHOLE, FailedUnit, KeptResults, Shard, run_kept, run_units
from tests.processes import needs_linux

ROOT = Path(__file__).parents[2]
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


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_come_with_the_number_of_their_unit(jobs: int) -> None:
    assert sorted(run_units(root, [4, 9, 16, 25], jobs)) == [(0, 2.0), (1, 3.0), (2, 4.0), (3, 5.0)]
    assert list(run_units(root, [], jobs)) == []


@needs_linux
def test_a_dead_worker_is_named_with_its_unit_and_the_others_finish() -> None:
    results = dict(run_units(root, [4, -1, 9, -1, 16], 2))
    assert [results[number] for number in (0, 2, 4)] == [2.0, 3.0, 4.0]
    for number in (1, 3):
        assert str(results[number]) == "-1: its process was killed by SIGKILL"
        assert isinstance(results[number], FailedUnit)
        assert isinstance(results[number].error, WorkerDied)
    assert not multiprocessing.active_children()


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_exception_is_named_with_its_unit_and_the_line(jobs: int) -> None:
    failed = dict(run_units(root, [4, -2, 9], jobs))[1]
    assert isinstance(failed, FailedUnit)
    assert str(failed).startswith("-2: ValueError: ")
    assert "(root, line " in str(failed)
    assert isinstance(failed.error, ValueError)


@pytest.mark.parametrize("jobs", [1, 2])
def test_stop_ends_an_endless_run(jobs: int) -> None:
    """What other processes work on at that moment is left out, and nothing else."""
    numbers = list[int]()
    for number, _ in run_units(root, count(), jobs, lambda: len(numbers) >= 5):
        numbers.append(number)
    assert len(set(numbers)) == len(numbers) >= 5
    assert len(set(range(max(numbers))) - set(numbers)) < jobs
    assert not multiprocessing.active_children()


@pytest.mark.parametrize("end", ["close", "throw"])
def test_the_processes_end_with_the_generator_whatever_they_do(end: str) -> None:
    results = run_units(wait_in_worker, [0, 1, 2, 3], 2)
    assert next(results) == (0, 0)
    assert len(multiprocessing.active_children()) == 2
    start = time.monotonic()
    if end == "close":
        results.close()
    else:
        with pytest.raises(KeyboardInterrupt):
            results.throw(KeyboardInterrupt)
    assert time.monotonic() - start < 4.0
    assert not multiprocessing.active_children()


@pytest.mark.parametrize("text", ["3/2", "0/2", "x", "1", "/2", "1/0", "-1/2", "1/2/3", "1.0/2", "9" * 5000 + "/2", ""])
def test_a_wrong_shard_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="expected NUMBER/COUNT such as 1/4, with 1 <= NUMBER <= COUNT"):
        Shard.parse(text)


def test_shards_are_every_nth_unit() -> None:
    assert [Shard.parse(f"{number}/3").part(range(7)) for number in (1, 2, 3)] == [
        range(0, 7, 3),
        range(1, 7, 3),
        range(2, 7, 3),
    ]
    assert Shard.parse("1/1") == WHOLE
    assert list(Shard.parse("5/9").part([1, 2])) == []


def kept_bytes(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def run(folder: Path, seeds: Any = range(6), jobs: int = 1) -> str:
    """The text of all results of a run in a folder, by unit."""
    kept = KeptResults(folder, Figures, RUN)
    return json.dumps(dict(run_kept(figures, {f"seed {seed}": seed for seed in seeds}, kept, jobs)), sort_keys=True)


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
SLOW = """
import sys, time
from pathlib import Path
from tests.core import test_work_units
quick = test_work_units.figures
def slow(seed):
    time.sleep(0.1)
    return quick(seed)
test_work_units.figures = slow
print("started", flush=True)
test_work_units.run(Path(sys.argv[1]), range(test_work_units.SEEDS))
"""


def start_slow(folder: Path) -> subprocess.Popen[str]:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    line = [sys.executable, "-c", SLOW, str(folder)]
    return subprocess.Popen(line, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_a_run_killed_in_the_middle_continues_and_gives_the_same_bytes(tmp_path: Path) -> None:
    single, folder = run(tmp_path / "single", range(SEEDS)), tmp_path / "killed"
    process = start_slow(folder)
    while not folder.is_dir() or len(list(folder.glob("[!.]*"))) < 3:
        time.sleep(0.01)
    process.kill()
    process.communicate()
    assert 3 <= len(list(folder.glob("[!.]*.json"))) < SEEDS
    assert run(folder, range(SEEDS)) == single
    written = {name: data for name, data in kept_bytes(folder).items() if not name.startswith(".")}
    assert written == kept_bytes(tmp_path / "single")


def test_two_processes_in_one_folder_do_not_disturb_each_other(tmp_path: Path) -> None:
    both = [start_slow(tmp_path / "both") for _ in range(2)]
    for process in both:
        _, errors = process.communicate(timeout=60)
        assert (process.returncode, errors) == (0, "")
    run(tmp_path / "single", range(SEEDS))
    assert kept_bytes(tmp_path / "both") == kept_bytes(tmp_path / "single")


def test_a_result_that_another_process_has_written_meanwhile_stays(tmp_path: Path) -> None:
    slower, faster = (KeptResults(tmp_path, float, RUN) for _ in range(2))
    assert faster.keep("x", 1.0) == 1.0
    assert slower.keep("x", 2.0) == 1.0


def test_another_run_is_refused_with_what_differs(tmp_path: Path) -> None:
    KeptResults(tmp_path, float, RUN).keep("x", 1.0)
    with pytest.raises(ConfigError) as caught:
        KeptResults(tmp_path, float, {"setting": "hard", "code": "ab12", "more": 1})
    assert str(caught.value) == (
        f"{tmp_path} has results of another run: setting 'easy', more None; this one has setting 'hard', more 1; "
        "choose another folder, or remove that one"
    )


DAMAGE: dict[str, Any] = {
    "cut": lambda text: text[:-20],
    "empty": lambda text: "",
    "binary": lambda text: b"\x00\xff\xfe" * 9,
    "a number": lambda text: "7",
    "a list": lambda text: "[1]",
    "another program": lambda text: '{"format": "other"}',
    "no run": lambda text: json.dumps({name: value for name, value in json.loads(text).items() if name != "run"}),
    "a run of another kind": lambda text: json.dumps(json.loads(text) | {"run": [1]}),
    "no result": lambda text: json.dumps({name: value for name, value in json.loads(text).items() if name != "result"}),
    "another number": lambda text: text.replace("1.0,", "1.5,").replace("1.0}", "1.5}"),
    "another unit": lambda text: text.replace('"unit": "x"', '"unit": "y"'),
    "another result": lambda text: json.dumps(json.loads(text) | {"result": "none"}),
    "deep": lambda text: "[" * 100_000,
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_file_is_one_error_and_stays_as_it_is(damage: str, tmp_path: Path) -> None:
    KeptResults(tmp_path, float, RUN).keep("x", 1.0)
    (path,) = tmp_path.iterdir()
    changed = DAMAGE[damage](path.read_text())
    path.write_bytes(changed if isinstance(changed, bytes) else changed.encode())
    before = path.read_bytes()
    with pytest.raises(ConfigError, match=r"x-[0-9a-f]{16}\.json: damaged, or no result of mecp_env") as caught:
        KeptResults(tmp_path, float, RUN)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400
    assert path.read_bytes() == before


def test_a_file_of_a_later_version_says_so(tmp_path: Path) -> None:
    KeptResults(tmp_path, float, RUN).keep("x", 1.0)
    (path,) = tmp_path.iterdir()
    path.write_text(json.dumps(json.loads(path.read_text()) | {"version": 2}))
    with pytest.raises(ConfigError, match=r"\.json: version 2, this mecp_env reads version 1"):
        KeptResults(tmp_path, float, RUN)


def test_other_files_and_those_of_a_killed_process_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / ".x.json.7.tmp").write_text("{")
    KeptResults(tmp_path, float, RUN).keep("x", 1.0)
    assert KeptResults(tmp_path, float, RUN).found == {"x": 1.0}
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.parametrize("name", ["../../x", "a/b", "x" * 300, "nül", "", "a\nb", "module:Class ab 000001"])
def test_any_name_of_a_unit_is_a_file_in_the_folder(name: str, tmp_path: Path) -> None:
    KeptResults(tmp_path / "kept", float, RUN).keep(name, 1.0)
    assert len(list((tmp_path / "kept").iterdir())) == 1
    assert KeptResults(tmp_path / "kept", float, RUN).found == {name: 1.0}


def test_a_full_disk_names_the_file_and_leaves_no_part_of_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = KeptResults(tmp_path, Figures, RUN)
    kept.keep("seed 0", figures(0))

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(files.os, "fsync", full)
    with pytest.raises(OSError, match="No space left on device") as caught:
        list(run_kept(figures, {"seed 0": 0, "seed 1": 1}, kept, 1))
    assert Path(str(caught.value.filename)).name.startswith("seed_1-")
    assert [path.name[:7] for path in tmp_path.iterdir()] == ["seed_0-"]
    monkeypatch.undo()
    assert len(dict(run_kept(figures, {"seed 0": 0, "seed 1": 1}, KeptResults(tmp_path, Figures, RUN), 1))) == 2


def test_a_folder_that_cannot_be_made_is_an_error_that_names_it(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        KeptResults(tmp_path / "file" / "kept", float, RUN).keep("x", 1.0)


@dataclass(frozen=True, slots=True)
class Inner:
    """A part of a result."""

    levels: dict[float, float] = field(default_factory=dict)


@dataclass(slots=True)
class Result:
    """A result with parts."""

    inner: Inner
    pair: tuple[int, float]
    rows: list[list[float]]
    ended: bool


def test_a_result_is_made_again_from_its_file(tmp_path: Path) -> None:
    given = Result(Inner({0.9: math.inf}), (np.int64(3), 0.1 + 0.2), np.eye(2), np.bool_(True))  # type: ignore[arg-type]
    read = KeptResults(tmp_path, Result, RUN).keep("x", given)
    assert read == Result(Inner({0.9: math.inf}), (3, 0.1 + 0.2), [[1.0, 0.0], [0.0, 1.0]], True)
    with pytest.raises(TypeError, match="a result holds no function"):
        KeptResults(tmp_path, Result, RUN).keep("y", root)
    assert len(list(tmp_path.iterdir())) == 1


def test_a_failed_unit_is_not_kept_and_is_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = KeptResults(tmp_path, float, RUN)
    results = dict(run_kept(root, {"good": 4, "bad": -2}, kept, 1))
    assert results["good"] == 2.0
    assert isinstance(results["bad"], FailedUnit)
    monkeypatch.setattr(work_units, "run_units", lambda task, units, jobs: iter_of((0, units)))
    assert list(islice(run_kept(root, {"good": 4, "bad": -2}, kept, 1), 1)) == [("good", 2.0)]
    assert len(list(tmp_path.iterdir())) == 1


def iter_of(*results: Any) -> Any:
    yield from results
