"""The benchmark `returns`: rank correlations, pairs that are apart, and what makes it fail."""

from pathlib import Path
from typing import Any

import pytest

from benchmarks import returns, uncertainty
from benchmarks.common import Options
from benchmarks.returns import ACTING, CORRECT, COVERAGE, SETTINGS
from mecp_env.episode.tasks import TASKS
from mecp_env.policies.rollout import CoverageCurve, EpisodeResult, EpisodeTask

METRIC = {"nearest": 0.8, "random_goal": 0.4, "standing": 0.1}


def toy(paid: dict[str, float]) -> Any:
    """Episodes whose metric and return depend on policy and building."""

    def episode(task: EpisodeTask) -> EpisodeResult:
        figures = {"reward": paid[task.policy], COVERAGE: METRIC[task.policy], CORRECT: METRIC[task.policy]}
        figures = {name: value + 0.01 * task.building for name, value in figures.items()}
        return EpisodeResult(task, CoverageCurve(), figures, 0.0)

    return episode


def run(monkeypatch: pytest.MonkeyPatch, folder: Path, paid: dict[str, float], **fields: Any) -> dict[str, Any]:
    monkeypatch.setattr(uncertainty, "run_episode", toy(paid))
    return returns.run(Options(buildings=4, policies=tuple(METRIC), sets=("First",), folder=folder, **fields))


def test_a_return_that_is_the_metric_ranks_as_it_does(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    figures = run(monkeypatch, tmp_path, METRIC)
    task = figures["tasks"]["First"]
    assert (task["tau"], task["tau_apart"], task["pairs_apart"]) == (1.0, 1.0, [3, 3])
    assert task["r"]["value"] == pytest.approx(1.0)
    assert task["random_of_nearest"]["value"] == pytest.approx(0.415 / 0.815)
    assert returns.faults(figures) == []
    assert "| nearest | 0.815 [" in returns.report(figures)


def test_it_fails_where_a_better_policy_is_paid_less(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    figures = run(monkeypatch, tmp_path, METRIC | {"random_goal": 0.9})
    assert figures["tasks"]["First"]["tau"] == pytest.approx(1.0 / 3.0)
    assert figures["tasks"]["First"]["contradictions"] == [["nearest", "random_goal"]]
    assert len(returns.faults(figures)) == 1


def test_policies_that_read_predictions_run_in_tasks_only() -> None:
    pytest.importorskip("safetensors", reason="needs the extra rl, as a trained policy is among them")
    for name in SETTINGS:
        assert set(ACTING) <= set(returns.policies_of(name, Options())) or name not in TASKS
    assert not set(ACTING) & set(returns.policies_of("medium", Options()))
