"""The evaluator: the same buildings for all policies, repeatable results, wrong input, failures, interruption."""

from __future__ import annotations

import csv
import errno
import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from mecp_env.cli import main as cli
from mecp_env.cli.evaluate import Evaluate
from mecp_env.core import files
from mecp_env.core.intervals import estimate
from mecp_env.core.work_units import WHOLE, FailedUnit, KeptResults, Shard, run_units
from mecp_env.policies.comparison import Row, compare, difference, rows_of
from mecp_env.policies.evaluation import Evaluation
from mecp_env.policies.explorers import Nearest
from mecp_env.policies.registry import Mask
from mecp_env.policies.report_table import cell, page
from mecp_env.policies.rollout import (
    LEAST_LOG_DET,
    EpisodeEnd,
    EpisodeResult,
    EpisodeTask,
    Setting,
    StepLog,
    is_complete,
    log_det,
    metrics,
    run_episode,
)
from tests.processes import gone_within, needs_linux

ROOT = Path(__file__).parents[2]
EASY = Setting("easy", "validation", "slam", 150)


def evaluate(tmp_path: Path, *policies: str, **options: Any) -> int:
    """The exit code of `mecp-env evaluate` on two small buildings."""
    small = {"split": "validation", "difficulty": "easy", "episodes": 2, "max_steps": 150, "out": tmp_path / "out"}
    return cli.main(["evaluate", *(policies or ("nearest", "random_goal")), *words(**(small | options))])


def words(**options: Any) -> list[str]:
    """Options as on a command line."""
    line: list[str] = []
    for name, value in options.items():
        option = name.replace("_", "-")
        line += (
            [f"--{option}" if value else f"--no-{option}"] if isinstance(value, bool) else [f"--{option}", str(value)]
        )
    return line


def evaluation_of(*policies: str, **options: Any) -> Evaluation:
    """An evaluation of two small buildings."""
    names = policies or ("nearest", "random_goal")
    return Evaluation(names, **({"setting": EASY, "episodes": 2} | options))


def toy(policy: str, building: int, auc: float, estimator: str = "slam") -> EpisodeResult:
    """An episode of which only the area under the curve matters."""
    log, final = (
        StepLog(lambda: np.zeros(6)),
        dict.fromkeys(("free_area_m2", "rooms", "rooms_found", "doors", "doors_found"), 1.0),
    )
    log.curve.add(0.0, 0, auc)
    log.correct.add(0.0, 0, auc)
    log.pose_errors_m, log.log_dets = [0.1, 0.3], [-30.0, -20.0]
    final |= {
        "coverage": auc,
        "correct_coverage": auc,
        "metres": 5.0,
        "periods": 9.0,
        "pose_error_final_m": 0.2,
        "landmarks": 4.0,
    }
    final |= {"duplicates": 0.0, "contacts": 1.0, "lost": False, "map_rmse_m": 0.01, "landmarks_false": 0.0}
    figures = metrics(log, EpisodeEnd(terminated=True, decisions=3, act_s=0.5), final, 100)
    return EpisodeResult(EpisodeTask(policy, building, Setting(estimator=estimator)), log.curve, figures, 0.5)


def test_the_same_task_gives_the_same_bits_and_another_seed_another_start() -> None:
    first, again, other = (run_episode(EpisodeTask("random_goal", building, EASY)) for building in (0, 0, 1))
    assert first.figures == again.figures
    assert (first.curve.metres, first.curve.coverage) == (again.curve.metres, again.curve.coverage)
    assert first.curve.coverage[0] != other.curve.coverage[0]


def test_all_policies_begin_in_the_same_building_at_the_same_place() -> None:
    episodes = [run_episode(EpisodeTask(name, 1, EASY)) for name in ("bfs", "random_goal", "random_walk")]
    assert len({episode.figures["free_area_m2"] for episode in episodes}) == 1
    assert len({episode.figures["budget_m"] for episode in episodes}) == 1
    assert len({episode.curve.coverage[0] for episode in episodes}) == 1


@pytest.mark.slow
def test_one_and_two_processes_give_the_same_result_bit_for_bit(tmp_path: Path) -> None:
    results = []
    for jobs in (1, 2):
        evaluation = evaluation_of("gain", "nearest", setting=replace(EASY, max_steps=60))
        assert len(list(evaluation.run(evaluation.kept(tmp_path / str(jobs)), jobs))) == 8
        results.append(same_in_every_run(evaluation.figures(evaluation.rows(), "")))
    assert results[0] == results[1]


def same_in_every_run(result: dict[str, Any]) -> str:
    """The part of a result that every repetition gives, as text."""
    return json.dumps({name: result[name] for name in result.keys() - {"timing", "date", "command"}}, sort_keys=True)


def contents(out: Path) -> tuple[str, bytes, bytes]:
    """What the files of an evaluation say that every repetition gives."""
    result = json.loads((out / "results.json").read_text())
    return same_in_every_run(result), (out / "episodes.csv").read_bytes(), (out / "curves.png").read_bytes()


QUICKLY = {"episodes": 3, "max_steps": 40, "truth": False}


@pytest.mark.slow
def test_shards_in_one_folder_and_then_the_command_without_give_the_bytes_of_a_single_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(tmp_path, out=tmp_path / "whole", **QUICKLY) == 0
    for number in (1, 2):
        assert evaluate(tmp_path, shard=f"{number}/2", **QUICKLY) == 0
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["episodes"]
    assert f"2 episodes of shard 2/2 are in {tmp_path / 'out' / 'episodes'}" in capsys.readouterr().out
    monkeypatch.setattr("mecp_env.policies.evaluation.run_episode", None)  # all episodes are there already
    assert evaluate(tmp_path, **QUICKLY) == 0
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")


@pytest.mark.slow
def test_a_killed_evaluation_continues_where_it_was(tmp_path: Path) -> None:
    assert evaluate(tmp_path, out=tmp_path / "whole", **QUICKLY) == 0
    small = {"split": "validation", "difficulty": "easy", "out": tmp_path / "out", "jobs": 2} | QUICKLY
    line = [sys.executable, "-m", "mecp_env", "evaluate", "nearest", "random_goal", *words(**small)]
    process = subprocess.Popen(line, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    assert "of 6 episodes" in process.stderr.readline()
    process.kill()
    process.communicate()
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "out" / "episodes").glob("*.json")}
    assert 1 <= len(kept) < 6
    assert evaluate(tmp_path, **QUICKLY) == 0
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")
    assert all(path.stat().st_mtime_ns == written for path, written in kept.items())


def test_a_full_disk_is_one_line_and_the_same_command_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    writes, write = [0], files.os.fsync

    def full_at_last(handle: int) -> None:
        writes[0] += 1
        if writes[0] == 3:  # after the first file and its folder
            raise OSError(errno.ENOSPC, "No space left on device")
        write(handle)

    with monkeypatch.context() as patch:
        patch.setattr(files.os, "fsync", full_at_last)
        assert evaluate(tmp_path, "nearest", **QUICKLY) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert re.fullmatch(r"mecp-env: .*/episodes/nearest_.*\.json: No space left on device", said)
    assert not list((tmp_path / "out" / "episodes").glob(".*"))
    assert evaluate(tmp_path, "nearest", **QUICKLY) == 0


@pytest.mark.slow
@needs_linux
def test_ctrl_c_while_processes_start_is_quiet_and_leaves_nothing(tmp_path: Path) -> None:
    """As a terminal sends it: to the command and its processes, which import modules for a second."""
    line = [sys.executable, "-m", "mecp_env", "evaluate", "nearest", *words(out=tmp_path / "out", jobs=2)]
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(line, cwd=ROOT, start_new_session=True, preexec_fn=deaf_no_more, **pipes)
    pids = list[int]()
    while len(pids) < 3 and process.poll() is None:  # the resource tracker of multiprocessing, and two workers
        time.sleep(0.02)
        pids = [int(pid) for pid in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()]
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (130, "", "mecp-env: interrupted; the same command continues\n")
    assert gone_within(pids, 5.0)


def deaf_no_more() -> None:
    """A test that runs in the background may have inherited that Ctrl-C is ignored."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def test_more_episodes_and_policies_use_those_that_are_there(tmp_path: Path) -> None:
    assert evaluate(tmp_path, "nearest", **QUICKLY) == 0
    kept = {path: path.read_bytes() for path in (tmp_path / "out" / "episodes").iterdir()}
    assert evaluate(tmp_path, "nearest", "gain", **(QUICKLY | {"episodes": 4})) == 0
    assert len(kept) == 3
    assert len(list((tmp_path / "out" / "episodes").iterdir())) == 8
    assert all(path.read_bytes() == content for path, content in kept.items())


def test_a_folder_of_another_setting_is_refused_and_stays_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(tmp_path, "nearest", **QUICKLY) == 0
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert evaluate(tmp_path, "nearest", **(QUICKLY | {"max_steps": 30})) == 2
    said = capsys.readouterr().err
    assert (
        f"{tmp_path / 'out' / 'episodes'} has results of another run: max_steps 40; this one has max_steps 30" in said
    )
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_a_changed_policy_is_another_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = "from mecp_env.policies.explorers import Nearest as Own\n"
    (tmp_path / "changing_policy.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    first = {task.name for task in evaluation_of("changing_policy:Own").tasks()}
    assert {task.name for task in evaluation_of("changing_policy:Own").tasks()} == first
    (tmp_path / "changing_policy.py").write_text(code + "# another\n")
    assert not {task.name for task in evaluation_of("changing_policy:Own").tasks()} & first


def test_shards_divide_the_buildings() -> None:
    parts = [evaluation_of(episodes=5, shard=Shard(number, 2)).tasks() for number in (1, 2)]
    assert [sorted({task.building for task in part}) for part in parts] == [[0, 2, 4], [1, 3]]
    assert sorted(map(str, parts[0] + parts[1])) == sorted(map(str, evaluation_of(episodes=5, shard=WHOLE).tasks()))


def test_everything_is_written_and_says_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert evaluate(tmp_path, record=True, json=tmp_path / "kept" / "policies.json", max_steps=80) == 0
    assert {path.name for path in out.iterdir()} == {
        "results.json",
        "page.md",
        "episodes.csv",
        "curves.png",
        "side_by_side.gif",
        "episodes",
    }
    result = json.loads((tmp_path / "kept/policies.json").read_text())
    assert [(row["policy"], row["estimator"]) for row in result["rows"]] == [
        ("nearest", "slam"),
        ("random_goal", "slam"),
        ("nearest", "truth"),
        ("random_goal", "truth"),
    ]
    assert (tmp_path / "kept/policies.md").read_text() == (out / "page.md").read_text()
    said = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in said[3:7]] == ["nearest", "random_goal", "nearest,", "random_goal,"]
    assert said[2].split("  ")[0] == "policy"
    assert len(said) == 9
    with (out / "episodes.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == 8
    assert result["command"].startswith("mecp-env evaluate nearest random_goal --split validation")
    mean = np.mean([float(line["auc"]) for line in lines if (line["policy"], line["estimator"]) == ("nearest", "slam")])
    assert result["rows"][0]["figures"]["auc"]["value"] == pytest.approx(mean)
    assert (out / "side_by_side.gif").stat().st_size < 2e6
    with Image.open(out / "side_by_side.gif") as film:
        assert film.n_frames > 3
        assert film.size == (640, 290)


def test_with_a_known_pose_there_is_no_pose_error() -> None:
    episode = run_episode(EpisodeTask("nearest", 0, Setting("easy", "validation", "truth", 100)))
    assert episode.figures["pose_error_mean_m"] < 1e-6
    assert episode.figures["log_det_mean"] <= -50.0


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"policies": ("nearst",)}, "nearst.*did you mean 'nearest'"),
        ({"policies": ()}, "policies: expected at least one of bfs"),
        ({"policies": ("nowhere:Policy",)}, "'nowhere:Policy' cannot be constructed: No module named 'nowhere'"),
        ({"policies": ("random:Policy",)}, "random:Policy' cannot be constructed: .*'Policy'"),
        ({"policies": ("random:Random",)}, "'random:Random' has no 'actions'"),
        ({"split": "tests"}, "train, validation, test; did you mean 'test'"),
        ({"difficulty": "medum"}, "medium"),
        ({"episodes": 0}, r"--episodes: .*greater than or equal to 1 \(given: 0\)"),
        ({"episodes": 1001}, "1000"),
        ({"episodes": 5000}, "episodes: 5000, each in a building of 'test'; building: 4999, there are 1000"),
        ({"reference": "gian"}, "one of nearest, bfs, .*random_walk, standing; did you mean 'gain'"),
        ({"jobs": 0}, r"--jobs: .*greater than or equal to 1 \(given: 0\)"),
        ({"max_steps": 0}, r"--max_steps: .*greater than or equal to 1 \(given: 0\)"),
        ({"jobs": 257}, r"--jobs: .*less than or equal to 256 \(given: 257\)"),
        ({"reference": "nerest"}, "reference: 'nerest'"),
        ({"json": Path(__file__).parent}, "policies is a folder, not a file"),
        ({"json": Path(__file__) / "a.json"}, "test_evaluate.py is a file, not a folder"),
        ({"out": Path(__file__) / "out"}, "--out: .*/test_evaluate.py is a file, not a folder"),
        ({"json": Path("page.md")}, "json: page.md: expected"),
        ({"shard": "3/2"}, "shard: '3/2', expected NUMBER/COUNT such as 1/4"),
    ],
)
def test_wrong_input_is_refused_before_anything_is_written(
    options: dict[str, Any], named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    policies = options.pop("policies", ("nearest",))
    line = words(**({"out": tmp_path / "out", "difficulty": "easy"} | options))
    assert cli.main(["evaluate", *policies, *line]) == 2
    message = capsys.readouterr().err
    assert re.search(named, message), message
    assert not (tmp_path / "out").exists()


def test_a_mistyped_estimator_gets_a_suggestion(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        evaluate(tmp_path, estimator="slm")
    assert "--estimator slm; did you mean 'slam'?" in capsys.readouterr().err


def test_without_the_reference_nothing_is_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate(tmp_path, "gain", episodes=1, max_steps=10, truth=False) == 0
    assert "nearest is not among the policies" in capsys.readouterr().err


def test_a_class_of_the_working_directory_is_a_policy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "own_policy.py").write_text("from mecp_env.policies.explorers import Nearest as Own\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [*sys.path])
    assert evaluate(tmp_path, "own_policy:Own", "nearest", episodes=1, max_steps=40, truth=False) == 0
    own = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("own_policy:Own"))
    assert "0.000 [-]" in own  # the difference; a single run has no interval


class Masked(Nearest):
    """Selects rows that are not offered."""

    def act(self, observation: dict[str, Any], mask: Mask = None) -> int:
        return 31


def test_a_score_that_is_that_of_the_nearest_goal_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate(tmp_path, f"{__name__}:Masked", "nearest", episodes=1, max_steps=20, truth=False) == 0
    said = capsys.readouterr().err
    assert "Masked chose an empty row in 100% of its decisions" in said
    assert "nearest chose" not in said


class NoAction(Nearest):
    """Returns no action."""

    def act(self, observation: dict[str, Any], mask: Mask = None) -> Any:
        return np.array([0.5])


def test_a_policy_whose_first_action_fails_is_refused_before_the_episodes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(tmp_path, f"{__name__}:NoAction", episodes=5, truth=False) == 2
    said = capsys.readouterr().err
    assert "NoAction' returned a wrong action: expected an integer in 0..31, given ndarray" in said
    assert not (tmp_path / "out").exists()


def test_ctrl_c_before_the_first_episode_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Evaluation, "kept", interrupted)
    assert evaluate(tmp_path) == 130
    assert capsys.readouterr().err == "mecp-env: interrupted\n"


def test_a_crash_names_policy_and_seed_and_the_rest_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fragile(task: EpisodeTask) -> EpisodeResult:
        if task.building == 1 and task.policy == "random_goal":
            raise RuntimeError("no way")
        return run_episode(task)

    monkeypatch.setattr("mecp_env.policies.evaluation.run_episode", fragile)
    assert evaluate(tmp_path, truth=False, episodes=3, max_steps=40) == 1
    said = capsys.readouterr()
    assert "policy random_goal" in said.err
    assert "building and seed 1" in said.err
    assert "RuntimeError: no way" in said.err
    assert "2 buildings" in said.out  # of which all policies have an episode
    assert "no way" in said.out


def test_a_failed_episode_is_run_again_by_the_same_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("mecp_env.policies.evaluation.run_episode", None)
        assert evaluate(tmp_path, "nearest", truth=False, episodes=1, max_steps=40) == 1
    assert "1 of 1 episodes" in capsys.readouterr().err
    assert evaluate(tmp_path, "nearest", truth=False, episodes=1, max_steps=40) == 0


def test_ctrl_c_keeps_what_is_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(task: EpisodeTask) -> EpisodeResult:
        if (task.policy, task.building) == ("random_goal", 2):
            raise KeyboardInterrupt
        return toy(task.policy, task.building, 0.5)

    monkeypatch.setattr("mecp_env.policies.evaluation.run_episode", interrupted)
    assert evaluate(tmp_path, truth=False, episodes=9) == 130
    result = json.loads((tmp_path / "out" / "results.json").read_text())
    assert result["interrupted"]
    assert result["buildings"] == 2  # the third was finished by one policy only
    said = capsys.readouterr()
    assert "\nnearest  " in said.out
    assert "mecp-env: 4 of 18 episodes" in said.err
    assert "interrupted; the same command continues" in said.err


def test_rows_are_over_the_buildings_that_every_policy_has_done() -> None:
    episodes = [toy("a", 0, 0.5), toy("a", 2, 0.7), toy("b", 2, 0.6), toy("b", 1, 0.9)]
    rows = rows_of(episodes, [("a", "slam"), ("b", "slam"), ("c", "slam")])
    assert [(row.policy, row.values("auc").tolist()) for row in rows] == [("a", [0.7]), ("b", [0.6])]
    assert rows_of([], [("a", "slam")]) == []


def test_differences_are_paired_by_building() -> None:
    noise = np.random.default_rng(0).uniform(0.1, 0.8, 30)
    first = Row("a", "slam", tuple(toy("a", i, x + 0.05) for i, x in enumerate(noise)))
    other = Row("b", "slam", tuple(toy("b", i, x) for i, x in enumerate(noise)))
    gap = difference(first, other)["auc"]
    assert gap["value"] == pytest.approx(0.05)
    assert gap["high"] - gap["low"] < 1e-9
    alone = estimate(first.values("auc"))
    assert alone["high"] - alone["low"] > 0.1


def test_each_row_is_compared_with_the_reference_and_with_itself_unsure() -> None:
    episodes = [toy(name, 0, x, e) for name, x, e in [("a", 0.5, "slam"), ("b", 0.6, "slam"), ("b", 0.9, "truth")]]
    a, b, sure = compare(rows_of(episodes, [("a", "slam"), ("b", "slam"), ("b", "truth")]), "a")
    assert "against_reference" not in a
    assert b["against_reference"]["auc"]["value"] == pytest.approx(0.1)
    assert "against_reference" not in sure  # the reference was not played with a known pose
    assert sure["with_the_pose_known"]["auc"]["value"] == pytest.approx(0.3)
    assert "with_the_pose_known" not in b
    assert sure["figures"]["log_det_mean"]["value"] is None


def test_the_bootstrap_interval_of_a_paired_difference_covers_it_about_95_times_in_100() -> None:
    rng, covered = np.random.default_rng(3), 0
    for _ in range(300):
        building = rng.normal(0.7, 0.2, 30)
        gap = estimate((building + rng.normal(0.03, 0.05, 30)) - (building + rng.normal(0.0, 0.05, 30)))
        covered += gap["low"] <= 0.03 <= gap["high"]
    assert 0.90 <= covered / 300 <= 0.98


def test_complete_is_found_seen_and_ended_by_itself() -> None:
    final = {"rooms": 3.0, "rooms_found": 3.0, "doors": 2.0, "doors_found": 2.0, "coverage": 0.97, "lost": False}
    assert is_complete(EpisodeEnd(terminated=True), final)
    assert not is_complete(EpisodeEnd(terminated=False), final)
    for lacking in ({"rooms_found": 2.0}, {"doors_found": 1.0}, {"coverage": 0.94}, {"lost": True}):
        assert not is_complete(EpisodeEnd(terminated=True), final | lacking)


def test_the_log_det_is_that_of_the_matrix() -> None:
    root = np.random.default_rng(2).normal(size=(3, 3))
    cov = root @ root.T
    six = cov[np.triu_indices(3)]
    assert log_det(six) == pytest.approx(np.linalg.slogdet(cov)[1])
    assert log_det(np.zeros(6)) == LEAST_LOG_DET


def test_a_building_never_seen_to_90_percent_counts_with_three_budgets_and_is_not_reached() -> None:
    never = toy("a", 0, 0.5).figures
    assert never["reached_90%"] == 0.0
    assert never["metres_to_90%"] == pytest.approx(3 * never["budget_m"])
    assert never["periods_to_90%"] == 100.0
    at_once = toy("a", 0, 0.95).figures
    assert (at_once["reached_90%"], at_once["metres_to_90%"], at_once["reached_99%"]) == (1.0, 0.0, 0.0)


def test_tasks_go_building_by_building_and_a_policy_named_twice_runs_once() -> None:
    tasks = evaluation_of("bfs", "nearest", "bfs").tasks()
    assert [(task.building, task.setting.estimator, task.policy) for task in tasks[:5]] == [
        (0, "slam", "bfs"),
        (0, "slam", "nearest"),
        (0, "truth", "bfs"),
        (0, "truth", "nearest"),
        (1, "slam", "bfs"),
    ]
    known = evaluation_of(setting=replace(EASY, estimator="truth"))
    assert {task.setting.estimator for task in known.tasks()} == {"truth"}


def test_the_page_has_a_line_per_row_with_intervals() -> None:
    assert cell({"value": 0.5, "low": 0.25, "high": 0.75}, ".0f", 100.0) == "50 [25, 75]"
    assert cell({"value": 1e-9, "low": -1e-9, "high": 2.0}, "+.1f", 1.0) == "0.0 [0.0, +2.0]"
    assert cell({"value": None, "low": None, "high": None}, ".0f", 1.0) == "-"
    evaluation = evaluation_of("nearest", "x")
    evaluation.results = [toy("nearest", 0, 0.5), toy("x", 0, 0.6, "truth")]
    text = page(evaluation.figures(evaluation.rows(), ""))
    assert "| nearest | 0.500 [-] |" in text
    assert "| x, pose known | 0.600" in text
    assert "1 buildings of the validation split of `easy`" in text


def test_the_page_that_is_printed_holds_no_sign_that_a_terminal_would_obey(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    evaluation = evaluation_of("a\x1b[31mb")
    evaluation.results = [toy("a\x1b[31mb", 0, 0.5)]
    Evaluate(("a\x1b[31mb",), out=tmp_path / "out")._write(evaluation, "")
    said = capsys.readouterr().out
    assert "\na?[31mb  " in said
    assert "\x1b" not in said


def test_failures_are_told_with_their_place(tmp_path: Path) -> None:
    ((_, failure),) = run_units(run_episode, [EpisodeTask("nearest", 2_000_000, EASY)], 1)
    assert isinstance(failure, FailedUnit)
    assert "policy nearest, easy, split validation, building and seed 2000000" in str(failure)
    assert "ConfigError: building: 2000000" in str(failure)


def test_an_episode_survives_its_file_bit_for_bit(tmp_path: Path) -> None:
    episode = run_episode(EpisodeTask("nearest", 1, replace(EASY, max_steps=40)))
    read = KeptResults(tmp_path, EpisodeResult, {}).keep("x", episode)
    assert (read.task, read.figures, read.act_s) == (episode.task, episode.figures, episode.act_s)
    assert read.curve.metres == episode.curve.metres
    assert read.curve.coverage == episode.curve.coverage
    assert read.curve.steps == episode.curve.steps
