"""Consistency of the covariance: NEES over many runs, and positivity over many steps (derivations 4.5)."""

import numpy as np
import pytest

from benchmarks import ring
from mecp_env.slam.config import FilterConfig

BAND = (2.41, 3.65)  # 95 % of the mean of 60 NEES of 3 degrees of freedom
QUICK = 24
TWO_LAPS = ring.make_course()
SLIP = np.array([0.05, np.radians(3.0)])  # m, rad: sideways and heading

RIEKF = ring.config_of("riekf")


@pytest.mark.slow
@pytest.mark.parametrize("variance", [ring.per_metre, ring.per_step])
def test_invariant_filter_is_consistent_over_sixty_runs(variance):
    runs = ring.monte_carlo(RIEKF, TWO_LAPS, 60, variance=variance)
    assert BAND[0] < runs.mean_nees(0.0, 0.5) < BAND[1]
    assert BAND[0] < runs.mean_nees(0.5, 1.0) < BAND[1]
    assert BAND[0] < runs.mean_nees(1.0, 2.0) < (BAND[1] if variance is not ring.per_step else 4.5)
    assert 1.8 < runs.nees[:, runs.closure].mean() < BAND[1]


def test_plain_filter_is_not_consistent():
    riekf, plain = (ring.monte_carlo(ring.config_of(kind), TWO_LAPS, QUICK) for kind in ("riekf", "ekf"))
    assert BAND[0] < riekf.mean_nees(1.0, 2.0) < BAND[1]
    assert plain.mean_nees(1.0, 2.0) > 1.5 * BAND[1]
    assert plain.error_m.mean() > riekf.error_m.mean()


def test_iterating_the_closure_keeps_it_consistent():
    """The literal reading of the paper's sigmas, with .25 m steps: the worst case of derivations 4.5."""
    once, iterated = (
        ring.monte_carlo(RIEKF, ring.make_course(laps=1.1), QUICK, variance=ring.per_step, iterate=iterate)
        for iterate in (False, True)
    )
    assert once.nees[:, once.closure].mean() > 1.5 * BAND[1]
    assert iterated.nees[:, iterated.closure].mean() < 1.25 * BAND[1]


def test_contacts_stay_consistent():
    """A contact in every eighth step, with the bumper flag that announces the slip to the filter."""
    rng = np.random.default_rng(7)
    config = FilterConfig(bumper_lateral_sigma_m=SLIP[0], bumper_heading_sigma_deg=np.degrees(SLIP[1]))
    steps = len(ring.straight_and_turn(0.25, 1))
    slips = SLIP * rng.normal(size=(QUICK, steps, 2)) * (np.arange(steps) % 8 == 0)[:, None]
    runs = ring.monte_carlo(config, [ring.make_course(laps=1, slips=s) for s in slips], QUICK)
    assert BAND[0] < runs.mean_nees(0.0, 1.0) < BAND[1]
