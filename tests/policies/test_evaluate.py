"""The evaluator: the same buildings for all policies, repeatable results, wrong input, failures, interruption."""

import csv
import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from mecp_env.cli import main as cli
from mecp_env.core.intervals import estimate
from mecp_env.core.work_units import WHOLE, KeptResults, Shard
from mecp_env.policies.evaluation import Evaluation, Row, compared, difference, rows_of
from mecp_env.policies.explorers import Nearest
from mecp_env.policies.registry import Mask
from mecp_env.policies.report import cell, page
from mecp_env.policies.rollout import (
    LEAST_LOG_DET,
    OVER_LIMITS,
    EpisodeLog,
    EpisodeResult,
    EpisodeTask,
    Setting,
    is_complete,
    log_det,
    metrics,
    run_episode,
)

ROOT = Path(__file__).parents[2]
EASY = Setting("easy", "validation", "slam", 60)


def evaluate(tmp_path: Path, policies: str = "nearest random_goal", out: str = "out", **options: Any) -> int:
    """The exit code of `mecp-env evaluate` in small buildings, shortly and without ground-truth poses."""
    small = {"split": "validation", "difficulty": "easy", "episodes": 3, "max_steps": 40, "out": tmp_path / out}
    line = [word for name, value in (small | options).items() for word in (f"--{name.replace('_', '-')}", str(value))]
    return cli.main(["evaluate", *policies.split(), *line, *([] if "json" in options else ["--no-truth"])])


def files_of(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def evaluation_of(*policies: str, **options: Any) -> Evaluation:
    """An evaluation of two small buildings."""
    names = policies or ("nearest", "random_goal")
    return Evaluation(names, **({"setting": EASY, "episodes": 2} | options))


FINAL = {"free_area_m2": 1.0, "rooms": 1.0, "rooms_found": 1.0, "doors": 1.0, "doors_found": 1.0, "metres": 5.0}
FINAL |= {"periods": 9.0, "pose_error_final_m": 0.2, "landmarks": 4.0, "duplicates": 0.0, "contacts": 1.0}
FINAL |= {"lost": False, "map_rmse_m": 0.01, "landmarks_false": 0.0}


def toy(policy: str, building: int, auc: float, estimator: str = "slam", terminated: bool = True) -> EpisodeResult:
    """An episode of which only the area under the curve matters."""
    log = EpisodeLog(pose_errors_m=[0.1, 0.3], log_dets=[-30.0, -20.0], terminated=terminated, decisions=3)
    log.curve.add(0.0, 0, auc)
    areas = dict.fromkeys(("coverage", "correct_coverage", *OVER_LIMITS.values()), auc)
    figures = metrics(log, FINAL | areas, 100)
    return EpisodeResult(EpisodeTask(policy, building, Setting(estimator=estimator)), log.curve, figures, 0.5)


def test_an_episode_follows_from_its_task_and_begins_where_all_others_do(tmp_path: Path) -> None:
    tasks = [("random_goal", 0), ("random_goal", 0), ("random_goal", 1), ("bfs", 1), ("random_walk", 1)]
    first, again, *same = (run_episode(EpisodeTask(name, building, EASY)) for name, building in tasks)
    assert first.figures == again.figures
    assert asdict(first.curve) == asdict(again.curve)
    assert first.curve.coverage[0] != same[0].curve.coverage[0]
    for figure in ("free_area_m2", "budget_m"):
        assert len({episode.figures[figure] for episode in same}) == 1
    assert len({episode.curve.coverage[0] for episode in same}) == 1
    read = KeptResults(tmp_path, EpisodeResult, {}).keep("x", first)  # through its file, bit for bit
    assert (read.task, read.figures, read.act_s) == (first.task, first.figures, first.act_s)
    assert asdict(read.curve) == asdict(first.curve)


def test_a_folder_is_continued_with_more_of_the_same_and_refused_for_another_setting(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(tmp_path, "nearest", episodes=2) == 0
    before, kept = files_of(tmp_path), files_of(tmp_path / "out" / "episodes")
    assert evaluate(tmp_path, "nearest", max_steps=30) == 2
    there = f"{tmp_path / 'out' / 'episodes'} has results of another run: max_steps 40; this one has max_steps 30"
    assert there in capsys.readouterr().err
    assert files_of(tmp_path) == before
    assert evaluate(tmp_path, "nearest gain") == 0
    now = files_of(tmp_path / "out" / "episodes")
    assert (len(kept), len(now)) == (2, 6)
    assert kept.items() <= now.items()


def test_a_changed_policy_is_another_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = "from mecp_env.policies.explorers import Nearest as Own\n"
    (tmp_path / "changing_policy.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    first = {task.name for task in evaluation_of("changing_policy:Own").tasks()}
    assert {task.name for task in evaluation_of("changing_policy:Own").tasks()} == first
    (tmp_path / "changing_policy.py").write_text(code + "# another\n")
    assert not {task.name for task in evaluation_of("changing_policy:Own").tasks()} & first


def test_tasks_go_building_by_building_and_a_policy_named_twice_runs_once() -> None:
    tasks = evaluation_of("bfs", "nearest", "bfs").tasks()
    found = [(task.building, task.setting.estimator, task.policy) for task in tasks[:5]]
    both = [(0, estimator, policy) for estimator in ("slam", "truth") for policy in ("bfs", "nearest")]
    assert found == [*both, (1, "slam", "bfs")]
    known = evaluation_of(setting=replace(EASY, estimator="truth"))
    assert {task.setting.estimator for task in known.tasks()} == {"truth"}
    parts = [evaluation_of(episodes=5, shard=Shard(number, 2)).tasks() for number in (1, 2)]
    assert [sorted({task.building for task in part}) for part in parts] == [[0, 2, 4], [1, 3]]
    assert sorted(map(str, parts[0] + parts[1])) == sorted(map(str, evaluation_of(episodes=5, shard=WHOLE).tasks()))


def test_everything_is_written_and_says_the_same(tmp_path: Path) -> None:
    out, kept = tmp_path / "out", tmp_path / "kept"
    assert evaluate(tmp_path, "nearest random_goal --record", json=kept / "policies.json", episodes=2) == 0
    written = {"results.json", "page.md", "episodes.csv", "curves.png", "side_by_side.gif", "episodes"}
    assert {path.name for path in out.iterdir()} == written
    result = json.loads((kept / "policies.json").read_text())
    names = [(policy, estimator) for estimator in ("slam", "truth") for policy in ("nearest", "random_goal")]
    assert [(row["policy"], row["estimator"]) for row in result["rows"]] == names
    assert (kept / "policies.md").read_text() == (out / "page.md").read_text()
    with (out / "episodes.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == 8
    assert result["command"].startswith("mecp-env evaluate nearest random_goal --record --split validation")
    mean = np.mean([float(line["auc"]) for line in lines if (line["policy"], line["estimator"]) == ("nearest", "slam")])
    assert result["rows"][0]["figures"]["auc"]["value"] == pytest.approx(mean)
    assert result["rows"][2]["figures"]["pose_error_mean_m"]["value"] < 1e-6  # the pose is known
    with Image.open(out / "side_by_side.gif") as film:
        assert film.n_frames > 3
        assert film.size == (640, 290)


class Masked(Nearest):
    """Selects rows that are not offered."""

    def act(self, observation: dict[str, Any], mask: Mask = None) -> int:
        return 31


class NoAction(Nearest):
    """Returns no action."""

    def act(self, observation: dict[str, Any], mask: Mask = None) -> Any:
        return np.array([0.5])


def test_a_policy_whose_first_action_fails_is_refused_before_the_episodes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(tmp_path, f"{__name__}:NoAction") == 2
    said = capsys.readouterr().err
    assert "NoAction' returned a wrong action: expected an integer in 0..31, given ndarray" in said
    assert not (tmp_path / "out").exists()


class Remembering(Nearest):
    """A policy with a state that `reset` keeps."""

    decisions = 0

    def act(self, observation: dict[str, Any], mask: Mask = None) -> int:
        self.decisions += 1
        return self.decisions


def test_a_policy_is_told_of_what_makes_its_score_one_of_another_or_of_chance(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(tmp_path, f"{__name__}:Masked {__name__}:Remembering gain", episodes=1, max_steps=20) == 0
    said = capsys.readouterr().err
    assert "Masked chose an empty row in 100% of its decisions" in said
    assert "Remembering acted differently when the beginning of an episode was repeated" in said
    assert "gain chose" not in said
    assert "gain acted" not in said
    assert "nearest is not among the policies" in said  # with which they would be compared


def raising(error: BaseException, building: int) -> Callable[[EpisodeTask], EpisodeResult]:
    """Stands for `run_episode`: an episode of `random_goal` in one building ends with an error."""

    def fragile(task: EpisodeTask) -> EpisodeResult:
        if (task.policy, task.building) == ("random_goal", building):
            raise error
        return toy(task.policy, task.building, 0.5)

    return fragile


def test_the_command_without_a_shard_takes_the_episodes_of_all_shards(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("mecp_env.policies.evaluation.run_episode", raising(RuntimeError(), 9))
    assert [evaluate(tmp_path, shard=shard) for shard in ("1/2", "2/2")] == [0, 0]
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["episodes"]
    assert f"2 episodes of shard 2/2 are in {tmp_path / 'out' / 'episodes'}" in capsys.readouterr().out
    monkeypatch.setattr("mecp_env.policies.evaluation.run_episode", None)  # all episodes are there already
    assert evaluate(tmp_path) == 0
    assert json.loads((tmp_path / "out" / "results.json").read_text())["buildings"] == 3


def test_a_crash_names_policy_and_seed_and_the_others_finish(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("mecp_env.policies.evaluation.run_episode", raising(RuntimeError("no way"), 1))
    assert evaluate(tmp_path) == 1
    said = capsys.readouterr()
    for words in ("policy random_goal", "building and seed 1", "RuntimeError: no way", "1 of 6 episodes"):
        assert words in said.err
    assert "2 buildings" in said.out  # of which all policies have an episode


def test_ctrl_c_keeps_what_is_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("mecp_env.policies.evaluation.run_episode", raising(KeyboardInterrupt(), 2))
    assert evaluate(tmp_path, episodes=9) == 130
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
    rows = rows_of(episodes, [("a", "slam"), ("b", "slam"), ("b", "truth")])
    a, b, sure = (compared(row, rows, "a") for row in rows)
    assert "against_reference" not in a
    assert b["against_reference"]["auc"]["value"] == pytest.approx(0.1)
    assert "against_reference" not in sure  # the reference was not played with a known pose
    assert sure["with_the_pose_known"]["auc"]["value"] == pytest.approx(0.3)
    assert "with_the_pose_known" not in b
    assert sure["figures"]["log_det_mean"]["value"] is None


def test_complete_is_found_seen_and_ended_by_itself() -> None:
    assert toy("a", 0, 0.97).figures["complete"]
    assert not toy("a", 0, 0.97, terminated=False).figures["complete"]
    assert is_complete(FINAL | {"coverage": 0.97})
    for lacking in ({"rooms_found": 2.0}, {"doors_found": 2.0}, {"coverage": 0.94}, {"lost": True}):
        assert not is_complete(FINAL | {"coverage": 0.97} | lacking)


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


def test_the_page_has_a_line_per_row_with_intervals() -> None:
    assert cell({"value": 0.5, "low": 0.25, "high": 0.75}, ".0f", 100.0) == "50 [25, 75]"
    assert cell({"value": 1e-9, "low": -1e-9, "high": 2.0}, "+.1f", 1.0) == "0.0 [0.0, +2.0]"
    assert cell({"value": None, "low": None, "high": None}, ".0f", 1.0) == "-"
    evaluation = evaluation_of("nearest", "x")
    evaluation.results = [toy("nearest", 0, 0.5), toy("x", 0, 0.6, "truth")]
    text = page(evaluation.figures(evaluation.rows(), ""))
    assert "| nearest | 0.500 [-] |" in text
    assert "| x, pose known | 0.600" in text
    assert "1 buildings: easy, split validation" in text
