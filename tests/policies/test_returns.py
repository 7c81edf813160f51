"""What returns say of the map: lost episodes against the others of a building, and correct coverage."""

from __future__ import annotations

import numpy as np
import pytest

from mecp_env.core.intervals import correlation
from mecp_env.policies.comparison import Row, returns_of
from mecp_env.policies.report_table import returns_table
from mecp_env.policies.rollout import CoverageCurve, EpisodeResult, EpisodeTask
from mecp_env.policies.setting import Setting


def row(policy: str, *episodes: tuple[float, float, bool]) -> Row:
    """The episodes of a policy: return, correct coverage at the end, and whether it was lost."""
    names = ("reward", "correct_coverage", "lost")
    figures = [dict(zip(names, map(float, values), strict=True)) for values in episodes]
    tasks = [EpisodeTask(policy, building, Setting()) for building in range(len(episodes))]
    results = (EpisodeResult(t, CoverageCurve(), f, 0.0) for t, f in zip(tasks, figures, strict=True))
    return Row(policy, "slam", tuple(results))


def test_lost_episodes_are_compared_with_the_others_of_their_building() -> None:
    first = row("a", (-4.0, 0.3, True), (9.0, 0.9, False), (-1.0, 0.5, True))
    other = row("b", (10.0, 0.9, False), (11.0, 1.0, False), (-2.0, 0.4, True))
    third = row("c", (20.0, 1.0, False), (-6.0, 0.2, True), (0.0, 0.5, True))
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
        found = returns_of([row("a", (1.0, 0.5, lost), (2.0, 0.6, lost))])
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
