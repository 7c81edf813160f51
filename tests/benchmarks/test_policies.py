"""The benchmarks of policies: prices paired by building, and whether returns rank as the metric does."""

from pathlib import Path
from typing import Any

import pytest

from benchmarks import returns, uncertainty
from benchmarks.common import OptionError, Options
from benchmarks.returns import ACTING, CORRECT, COVERAGE, SETTINGS
from benchmarks.uncertainty import BASE, CHANGES, ESTIMATORS, METRIC
from mecp_env.core.errors import ConfigError
from mecp_env.episode.tasks import TASKS
from mecp_env.policies.explorers import Nearest
from mecp_env.policies.rollout import CoverageCurve, EpisodeResult, EpisodeTask, make_rooms
from mecp_env.policies.setting import Setting

QUALITY = {"slam": 0.5, "known": 0.6, "truth": 0.8}  # of an estimator
SCORE = {"nearest": 0.8, "random_goal": 0.4, "standing": 0.1}  # of a policy


def priced(task: EpisodeTask) -> EpisodeResult:
    """Metrics that depend on estimator, policy and building."""
    estimator = task.setting.estimator
    metrics = dict.fromkeys(uncertainty.KEPT, 0.1) | {"lost": float(estimator == "slam")}
    metrics[METRIC] = QUALITY[estimator] + 0.01 * task.building + 0.2 * (task.policy == "gain")
    return EpisodeResult(task, CoverageCurve(), metrics, 0.0)


def test_prices_are_paired_by_building(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(uncertainty, "run_episode", priced)
    figures = uncertainty.run(Options(buildings=4, policies=("next_best_view", "gain"), folder=tmp_path))
    assert set(figures["points"]) == set(CHANGES)
    found = figures["points"]["odometry_x8"]["gain"]
    assert found["price"]["value"] == pytest.approx(0.3)
    assert found["price"]["high"] - found["price"]["low"] < 1e-9
    assert found["price_known"]["value"] == pytest.approx(0.1)
    assert (found["over"]["value"], found["over"]["n"]) == (pytest.approx(0.2), 4)  # the greedy one
    assert found["slam"][METRIC]["high"] > found["slam"][METRIC]["low"]
    assert (found["slam"]["lost"]["value"], found["truth"]["lost"]["value"]) == (1.0, 0.0)
    page = uncertainty.report(figures)
    assert "## Odometry noise x8, range 2.5 m, 4 buildings" in page
    assert "| gain | 0.715 [0.705, 0.725] | 0.815" in page
    assert "+0.300 [+0.300, +0.300] | +0.100 [+0.100, +0.100] | +0.200 [+0.200, +0.200] |" in page
    axes = uncertainty.axes_of(figures)
    assert list(axes["odometry noise"].values()) == ["x1", "x2", "x4", "x8"]
    assert list(axes["laser range"].values()) == ["2.5 m", "3 m", "5 m", "8 m", "30 m"]
    panels = uncertainty.figure(figures).axes
    assert [panel.get_title() for panel in panels] == 2 * list(ESTIMATORS.values())


@pytest.mark.parametrize("task", TASKS)
def test_every_point_changes_its_field_of_every_task(task: str) -> None:
    for point, changes in CHANGES.items():
        env = make_rooms(Setting("", "test", "slam", 20, task, env=changes), Nearest())
        config = env.get_wrapper_attr("config")
        env.close()
        own = uncertainty.range_of(task)
        assert config.odometry.scale == changes.get("odometry", {}).get("scale", 1.0)
        assert config.laser.max_range_m == changes.get("laser", {}).get("max_range_m", own)
        assert config.odometry.preset == TASKS[task]["odometry"]["preset"]
        assert (point == BASE) == (not changes)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (Options(task="ActiveHall-v0"), "--task ActiveHall-v0: expected one of .*; did you mean 'ActiveHalls-v0'"),
        (Options(buildings=1001), "--buildings 1001: the split has 1000"),
        (Options(sets=("odometry_x3",)), "--sets odometry_x3: expected one of base, odometry_x2"),
    ],
)
def test_wrong_options_are_refused(options: Options, said: str) -> None:
    with pytest.raises(OptionError, match=said):
        uncertainty.run(options)
    with pytest.raises(ConfigError, match="did you mean 'nearest'"):
        uncertainty.run(Options(policies=("nearst",)))


def returned(monkeypatch: pytest.MonkeyPatch, folder: Path, paid: dict[str, float]) -> dict[str, Any]:
    """The figures of episodes whose metric and return depend on policy and building."""

    def episode(task: EpisodeTask) -> EpisodeResult:
        values = {"reward": paid[task.policy], COVERAGE: SCORE[task.policy], CORRECT: SCORE[task.policy]}
        figures = {name: value + 0.01 * task.building for name, value in values.items()}
        return EpisodeResult(task, CoverageCurve(), figures, 0.0)

    monkeypatch.setattr(uncertainty, "run_episode", episode)
    return returns.run(Options(buildings=4, policies=tuple(SCORE), sets=("First",), folder=folder))


def test_a_return_that_is_the_metric_ranks_as_it_does(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    figures = returned(monkeypatch, tmp_path, SCORE)
    task = figures["tasks"]["First"]
    assert (task["tau"], task["tau_apart"], task["pairs_apart"]) == (1.0, 1.0, [3, 3])
    assert task["r"]["value"] == pytest.approx(1.0)
    assert task["random_of_nearest"]["value"] == pytest.approx(0.415 / 0.815)
    assert returns.faults(figures) == []
    assert "| nearest | 0.815 [" in returns.report(figures)


def test_it_fails_where_a_better_policy_is_paid_less(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    figures = returned(monkeypatch, tmp_path, SCORE | {"random_goal": 0.9})
    assert figures["tasks"]["First"]["tau"] == pytest.approx(1.0 / 3.0)
    assert figures["tasks"]["First"]["contradictions"] == [["nearest", "random_goal"]]
    assert len(returns.faults(figures)) == 1


def test_policies_that_read_predictions_run_in_tasks_only() -> None:
    pytest.importorskip("safetensors", reason="needs the extra rl, as a trained policy is among them")
    for name in SETTINGS:
        assert set(ACTING) <= set(returns.policies_of(name, Options())) or name not in TASKS
    assert not set(ACTING) & set(returns.policies_of("medium", Options()))
