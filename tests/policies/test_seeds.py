"""Trainings with several seeds taken together: names, means, and intervals that hold for another training."""

from __future__ import annotations

import numpy as np
import pytest

from mecp_env.core.intervals import estimate, over_runs
from mecp_env.policies.comparison import COMPARED, Row, by_name, seeds_of
from mecp_env.policies.report_table import seeds_table
from mecp_env.policies.rollout import CoverageCurve, EpisodeResult, EpisodeTask
from mecp_env.policies.setting import Setting


def row(policy: str, *values: float) -> Row:
    """The episodes of a policy, one in each building, with all metrics equal."""
    tasks = [EpisodeTask(policy, building, Setting()) for building in range(len(values))]
    results = (
        EpisodeResult(task, CoverageCurve(), dict.fromkeys(COMPARED, value), 0.0)
        for task, value in zip(tasks, values, strict=True)
    )
    return Row(policy, "slam", tuple(results))


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
