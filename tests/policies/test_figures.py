"""Figures of an evaluation, by hand: coverage over metres, returns of lost episodes, several seeds of a training."""

import numpy as np
import pytest

from mecp_env.core.intervals import budget_m, correlation, estimate, over_runs
from mecp_env.policies.evaluation import COMPARED, Row, by_name, returns_of, seeds_of
from mecp_env.policies.report import returns_table, seeds_table
from mecp_env.policies.rollout import CoverageCurve, EpisodeResult, EpisodeTask
from mecp_env.policies.setting import Setting


def row_of(policy: str, *figures: dict[str, float]) -> Row:
    """The episodes of a policy, one in each building."""
    tasks = [EpisodeTask(policy, building, Setting()) for building in range(len(figures))]
    return Row(
        policy, "slam", tuple(EpisodeResult(t, CoverageCurve(), f, 0.0) for t, f in zip(tasks, figures, strict=True))
    )


def lost_row(policy: str, *episodes: tuple[float, float, bool]) -> Row:
    """Of each episode the return, correct coverage at the end, and whether it was lost."""
    names = ("reward", "correct_coverage", "lost")
    return row_of(policy, *(dict(zip(names, map(float, values), strict=True)) for values in episodes))


def row(policy: str, *values: float) -> Row:
    """All metrics are equal."""
    return row_of(policy, *(dict.fromkeys(COMPARED, value) for value in values))


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


def test_a_level_never_reached_or_beyond_the_limit_counts_as_the_limit(curve: CoverageCurve) -> None:
    assert curve.metres_to(0.9, 30.0) == 6.0
    assert curve.steps_to(0.5, 100.0) == 5.0
    assert curve.metres_to(0.99, 30.0) == 30.0
    assert curve.steps_to(0.99, 100.0) == 100.0
    assert curve.metres_to(0.9, 5.0) == 5.0


def test_turning_on_the_spot_costs_no_metres() -> None:
    curve = CoverageCurve()
    for step in range(3):
        curve.add(0.0, step, 0.1 * (step + 1))
    curve.add(1.0, 3, 0.8)
    assert curve.area_under(2.0) == pytest.approx((0.3 + 0.8) / 2)


def test_lost_episodes_are_compared_with_the_others_of_their_building() -> None:
    first = lost_row("a", (-4.0, 0.3, True), (9.0, 0.9, False), (-1.0, 0.5, True))
    other = lost_row("b", (10.0, 0.9, False), (11.0, 1.0, False), (-2.0, 0.4, True))
    third = lost_row("c", (20.0, 1.0, False), (-6.0, 0.2, True), (0.0, 0.5, True))
    found = returns_of([first, other, third])
    assert found["lost"]["n"] == 2  # in the third building, all were lost
    assert found["lost"]["value"] == pytest.approx((-4.0 - 6.0) / 2)
    assert found["others"]["value"] == pytest.approx((15.0 + 10.0) / 2)
    assert found["difference"]["value"] == pytest.approx(-17.5)
    assert found["ratio"]["value"] == pytest.approx(-0.4)
    assert found["correlation"]["n"] == 9
    expected = "| 2 buildings with both | -5.000 [-6.000, -4.000] | 12.500 [10.000, 15.000] |"
    assert expected in returns_table({"returns": found})


def test_where_none_or_all_were_lost_there_is_nothing_to_compare() -> None:
    for lost in (False, True):
        found = returns_of([lost_row("a", (1.0, 0.5, lost), (2.0, 0.6, lost))])
        assert found["lost"]["value"] is None
        assert found["correlation"]["value"] == pytest.approx(1.0)
        assert returns_table({"returns": found}) == ""
    assert returns_of([])["correlation"]["value"] is None
    assert returns_table({}) == ""  # of an older result


def test_the_correlation_is_that_of_numpy_and_its_interval_widens_when_the_values_of_a_run_agree() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(1, 60))
    y = x + rng.normal(size=(1, 60))
    once, copied = correlation(x, y), correlation(np.repeat(x, 4, axis=0), np.repeat(y, 4, axis=0))
    assert once["value"] == pytest.approx(np.corrcoef(x[0], y[0])[0, 1])
    assert once["low"] < once["value"] < once["high"]
    assert [copied[end] for end in ("value", "low", "high")] == pytest.approx(
        [once[end] for end in ("value", "low", "high")]
    )  # four copies of a run say no more than one
    assert correlation(x, np.ones_like(x))["value"] is None
    assert correlation([[1.0]], [[2.0]])["value"] is None


def test_runs_that_differ_in_their_last_number_are_taken_together() -> None:
    names = ["runs/a-0", "runs/a-1", "gain", "runs/b-7", "module:Class", "runs/a-10", "c-1/best"]
    found = by_name([row(name, 1.0) for name in names])
    assert list(found) == ["runs/a-*", "gain", "runs/b-7", "module:Class", "c-1/best"]
    assert [each.policy for each in found["runs/a-*"]] == ["runs/a-0", "runs/a-1", "runs/a-10"]


def test_a_group_is_compared_with_policies_and_other_groups() -> None:
    rows = [
        row("a-0", 0.5, 0.7),
        row("a-1", 0.7, 0.9),
        row("b-0", 0.4, 0.4),
        row("b-1", 0.2, 0.4),
        row("gain", 0.6, 0.6),
    ]
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
