"""Coverage over metres: what is read from the curve, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from mecp_env.core.budget import budget_m
from mecp_env.policies.rollout import CoverageCurve


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
    assert curve.area_under_steps(40) == pytest.approx((5 * 0.2 + 15 * 0.5 + 20 * 0.9) / 40)
    assert curve.at(np.array([0.0, 1.99, 2.0, 6.0, 500.0])).tolist() == [0.2, 0.2, 0.5, 0.9, 0.9]
    assert budget_m(150.0) == 75.0


def test_a_level_never_reached_or_beyond_the_limit_counts_as_the_limit(curve: CoverageCurve) -> None:
    assert curve.metres_to(0.9, 30.0) == 6.0
    assert curve.steps_to(0.5, 100.0) == 5.0
    assert curve.metres_to(0.99, 30.0) == 30.0
    assert curve.steps_to(0.99, 100.0) == 100.0
    assert curve.metres_to(0.9, 5.0) == 5.0


def test_a_coverage_that_may_fall_keeps_each_change() -> None:
    made = CoverageCurve(falls=True)
    for metres, step, coverage in [(0, 0, 0.2), (1, 3, 0.2), (2, 5, 0.5), (6, 10, 0.1)]:
        made.add(metres, step, coverage)
    assert made.steps == [0, 5, 10]
    assert made.area_under_steps(20) == pytest.approx((5 * 0.2 + 5 * 0.5 + 10 * 0.1) / 20)


def test_turning_on_the_spot_costs_no_metres() -> None:
    curve = CoverageCurve()
    for step in range(3):
        curve.add(0.0, step, 0.1 * (step + 1))
    curve.add(1.0, 3, 0.8)
    assert curve.area_under(2.0) == pytest.approx((0.3 + 0.8) / 2)
