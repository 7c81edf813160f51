"""Figures of an evaluation, by hand: coverage over metres, intervals, several seeds of a training."""

import numpy as np
import pytest

from mecp_env.core.intervals import budget_m, correlation, estimate, over_runs
from mecp_env.policies.evaluation import COMPARED, Row, by_name, seeds_of
from mecp_env.policies.report import seeds_table
from mecp_env.policies.rollout import CoverageCurve, EpisodeResult, EpisodeTask
from mecp_env.policies.setting import Setting


def row(policy: str, *values: float) -> Row:
    """The episodes of a policy, one in each building, in which all metrics are equal."""
    tasks = [EpisodeTask(policy, building, Setting()) for building in range(len(values))]
    figures = [dict.fromkeys(COMPARED, value) for value in values]
    results = (EpisodeResult(t, CoverageCurve(), f, 0.0) for t, f in zip(tasks, figures, strict=True))
    return Row(policy, "slam", tuple(results))


@pytest.fixture
def curve() -> CoverageCurve:
    """0.2 at the start, 0.5 after 2 m, 0.9 after 6 m; then to 12 m without anything new."""
    made = CoverageCurve()
    for metres, step, coverage in [(0, 0, 0.2), (1, 3, 0.2), (2, 5, 0.5), (6, 20, 0.9), (12, 40, 0.9)]:
        made.add(metres, step, coverage)
    return made


def test_the_area_under_the_curve_by_hand(curve: CoverageCurve) -> None:
    assert (curve.metres, curve.steps) == ([0, 2, 6], [0, 5, 20])  # only what is more is kept
    assert curve.area_under(10.0) == pytest.approx((2 * 0.2 + 4 * 0.5 + 4 * 0.9) / 10.0)
    assert curve.area_under(4.0) == pytest.approx((2 * 0.2 + 2 * 0.5) / 4.0)
    assert curve.area_under(2.0) == pytest.approx(0.2)
    assert curve.area_under(1000.0) == pytest.approx(0.9, abs=0.005)
    assert curve.at(np.array([0.0, 1.99, 2.0, 6.0, 500.0])).tolist() == [0.2, 0.2, 0.5, 0.9, 0.9]
    assert budget_m(150.0) == 75.0
    curve.add(12, 41, 1.0)  # turning on the spot costs no metres
    curve.add(12, 42, 1.1)
    assert curve.area_under(13.0) == pytest.approx((2 * 0.2 + 4 * 0.5 + 6 * 0.9 + 1.1) / 13.0)


def test_a_level_never_reached_or_beyond_the_limit_counts_as_the_limit(curve: CoverageCurve) -> None:
    assert curve.metres_to(0.9, 30.0) == 6.0
    assert curve.steps_to(0.5, 100.0) == 5.0
    assert curve.metres_to(0.99, 30.0) == 30.0
    assert curve.steps_to(0.99, 100.0) == 100.0
    assert curve.metres_to(0.9, 5.0) == 5.0


def test_the_correlation_is_that_of_numpy_and_its_interval_widens_when_the_values_of_a_run_agree() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(1, 60))
    y = x + rng.normal(size=(1, 60))
    once, copied = correlation(x, y), correlation(np.repeat(x, 4, axis=0), np.repeat(y, 4, axis=0))
    assert once["value"] == pytest.approx(np.corrcoef(x[0], y[0])[0, 1])
    assert once["low"] < once["value"] < once["high"]
    ends = ("value", "low", "high")
    assert [copied[end] for end in ends] == pytest.approx([once[end] for end in ends])  # four copies say no more
    assert correlation(x, np.ones_like(x))["value"] is None
    assert correlation([[1.0]], [[2.0]])["value"] is None


def test_runs_that_differ_in_their_last_number_are_taken_together() -> None:
    names = ["runs/a-0", "runs/a-1", "gain", "runs/b-7", "module:Class", "runs/a-10", "c-1/best"]
    found = by_name([row(name, 1.0) for name in names])
    assert list(found) == ["runs/a-*", "gain", "runs/b-7", "module:Class", "c-1/best"]
    assert [each.policy for each in found["runs/a-*"]] == ["runs/a-0", "runs/a-1", "runs/a-10"]


def test_a_group_is_compared_with_policies_and_other_groups() -> None:
    given = {"a-0": (0.5, 0.7), "a-1": (0.7, 0.9), "b-0": (0.4, 0.4), "b-1": (0.2, 0.4), "gain": (0.6, 0.6)}
    rows = [row(name, *values) for name, values in given.items()]
    ours, others = seeds_of(rows)
    assert (ours["policy"], ours["seeds"], others["policy"]) == ("a-*", 2, "b-*")
    assert ours["figures"]["lost"]["value"] == pytest.approx(0.7)
    assert list(ours["differences"]) == ["b-*", "gain"]
    assert ours["differences"]["b-*"]["auc"]["value"] == pytest.approx(0.35)
    assert ours["differences"]["gain"]["auc"]["value"] == pytest.approx(0.1)
    assert ours["differences"]["gain"]["auc"]["n"] == 2
    text = seeds_table({"seeds": [ours, others]})
    assert "| a-* (2 seeds) - gain | +0.100 [" in text
    assert "| b-* (2 seeds) - a-* | -0.350 [" in text
    assert seeds_of(rows[-1:]) == []
    assert seeds_table({}) == seeds_table({"seeds": []}) == ""


def test_a_single_run_has_the_interval_of_its_cases_and_a_nan_is_missing() -> None:
    values = np.random.default_rng(0).normal(0.5, 0.2, 64)
    alone, usual = over_runs(values), estimate(values)
    assert alone["value"] == pytest.approx(usual["value"])
    assert [alone[end] for end in ("low", "high")] == pytest.approx([usual[end] for end in ("low", "high")], abs=0.01)
    pair = np.stack([values, values + 0.2])
    pair[1, 3] = np.nan
    assert over_runs(pair, values)["n"] == 63
    assert over_runs(pair, values)["value"] == pytest.approx(0.1)
    assert over_runs(np.full((2, 3), np.nan))["value"] is None


def test_the_interval_holds_for_other_trainings_in_other_cases() -> None:
    """Of 200 experiments with five seeds each (sigma .05) in 64 cases (sigma .2, shared), most contain the truth."""
    rng, holds, narrow = np.random.default_rng(1), 0, 0
    for _ in range(200):
        ours, theirs = (rng.normal(0.0, 0.05, (5, 1)) + rng.normal(0.0, 0.1, (5, 64)) for _ in range(2))
        cases = rng.normal(0.5, 0.2, 64)
        found, cases_only = over_runs(ours + cases, theirs + cases), estimate(ours.mean(axis=0) - theirs.mean(axis=0))
        holds += found["low"] <= 0.0 <= found["high"]
        narrow += cases_only["low"] <= 0.0 <= cases_only["high"]
    assert holds > 0.88 * 200
    assert narrow < 0.8 * 200  # an interval over cases alone says nothing of another training
