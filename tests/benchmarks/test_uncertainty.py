"""The benchmark `uncertainty`: its points, paired prices, tables and figure."""

from pathlib import Path
from typing import Any

import pytest

from benchmarks import uncertainty
from benchmarks.common import OptionError, Options
from benchmarks.uncertainty import BASE, CHANGES, ESTIMATORS, METRIC
from mecp_env.core.errors import ConfigError
from mecp_env.episode.tasks import TASKS
from mecp_env.policies.explorers import Nearest
from mecp_env.policies.rollout import CoverageCurve, EpisodeResult, EpisodeTask, make_rooms
from mecp_env.policies.setting import Setting

QUALITY = {"slam": 0.5, "known": 0.6, "truth": 0.8}


def toy(task: EpisodeTask) -> EpisodeResult:
    """Metrics that depend on estimator, policy and building."""
    estimator = task.setting.estimator
    metrics = dict.fromkeys(uncertainty.KEPT, 0.1) | {"lost": float(estimator == "slam")}
    metrics[METRIC] = QUALITY[estimator] + 0.01 * task.building + 0.2 * (task.policy == "gain")
    return EpisodeResult(task, CoverageCurve(), metrics, 0.0)


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[str, Any]:
    monkeypatch.setattr(uncertainty, "run_episode", toy)
    return uncertainty.run(Options(buildings=4, policies=("next_best_view", "gain"), folder=tmp_path))


def test_prices_are_paired_by_building(figures: dict[str, Any]) -> None:
    assert set(figures["points"]) == set(CHANGES)
    found = figures["points"]["odometry_x8"]["gain"]
    assert found["price"]["value"] == pytest.approx(0.3)
    assert found["price"]["high"] - found["price"]["low"] < 1e-9
    assert found["price_known"]["value"] == pytest.approx(0.1)
    assert (found["over"]["value"], found["over"]["n"]) == (pytest.approx(0.2), 4)  # the greedy one
    assert found["slam"][METRIC]["n"] == 4
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


def test_every_point_changes_its_field_of_every_task() -> None:
    for task in TASKS:
        for point, changes in CHANGES.items():
            env = make_rooms(Setting("", "test", "slam", 20, task, env=changes), Nearest())
            config = env.get_wrapper_attr("config")
            env.close()
            own = uncertainty.range_of(task)
            assert config.odometry.scale == changes.get("odometry", {}).get("scale", 1.0)
            assert config.laser.max_range_m == changes.get("laser", {}).get("max_range_m", own)
            assert config.odometry.preset == TASKS[task]["odometry"]["preset"]
            assert (point == BASE) == (not changes)


def test_wrong_options_are_refused() -> None:
    for options, said in (
        (Options(task="ActiveHall-v0"), "--task ActiveHall-v0: expected one of .*; did you mean 'ActiveHalls-v0'"),
        (Options(buildings=1001), "--buildings 1001: the split has 1000"),
        (Options(sets=("odometry_x3",)), "--sets odometry_x3: expected one of base, odometry_x2"),
    ):
        with pytest.raises(OptionError, match=said):
            uncertainty.run(options)
    with pytest.raises(ConfigError, match="did you mean 'nearest'"):
        uncertainty.run(Options(policies=("nearst",)))
