"""Consistency of the covariance: NEES over many runs, and positivity over many steps (derivations 4.5)."""

from __future__ import annotations

import copy
import os
import subprocess
import sys
from functools import cache

import numpy as np
import pytest

from benchmarks import ring
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import make_filter
from tests.slam import make

BAND = (2.41, 3.65)  # 95 % of the mean of 60 NEES of 3 degrees of freedom
QUICK = 24
TWO_LAPS = ring.make_course()
SLIP = np.array([0.05, np.radians(3.0)])  # m, rad: sideways and heading

RIEKF, EKF = ring.config_of("riekf"), ring.config_of("ekf")


@pytest.fixture(scope="module")
def riekf() -> ring.Runs:
    return ring.monte_carlo(RIEKF, TWO_LAPS, QUICK)


@pytest.fixture(scope="module")
def rough() -> ring.Runs:
    """The literal reading of the paper's sigmas, with .25 m steps: the worst case of derivations 4.5."""
    return ring.monte_carlo(RIEKF, TWO_LAPS, QUICK, variance=ring.per_step)


def test_invariant_filter_is_consistent(riekf):
    assert BAND[0] < riekf.mean_nees(0.0, 1.0) < BAND[1]
    assert BAND[0] < riekf.mean_nees(1.0, 2.0) < BAND[1]


@pytest.mark.slow
@pytest.mark.parametrize("variance", [ring.per_metre, ring.linear, ring.per_step])
def test_invariant_filter_is_consistent_over_sixty_runs(variance):
    runs = ring.monte_carlo(RIEKF, TWO_LAPS, 60, variance=variance)
    assert BAND[0] < runs.mean_nees(0.0, 0.5) < BAND[1]
    assert BAND[0] < runs.mean_nees(0.5, 1.0) < BAND[1]
    assert BAND[0] < runs.mean_nees(1.0, 2.0) < (BAND[1] if variance is not ring.per_step else 4.5)
    assert 1.8 < runs.nees[:, runs.closure].mean() < BAND[1]


def test_the_loop_is_closed_and_pays(riekf):
    before = np.sqrt((riekf.error_m[:, riekf.closure - 5] ** 2).mean())
    after = np.sqrt((riekf.error_m[:, riekf.closure] ** 2).mean())
    assert after < 0.5 * before


def test_arcs_within_a_step_add_up():
    runs = ring.monte_carlo(RIEKF, ring.make_course(laps=1), QUICK, arcs_per_step=4)
    assert BAND[0] < runs.mean_nees(0.0, 1.0) < BAND[1]


def test_plain_filter_is_not_consistent(riekf):
    plain = ring.monte_carlo(EKF, TWO_LAPS, QUICK)
    assert plain.mean_nees(1.0, 2.0) > 1.5 * BAND[1]
    assert plain.error_m.mean() > riekf.error_m.mean()


def test_sigmas_per_short_step_break_the_plain_filter_only(rough):
    plain = ring.monte_carlo(EKF, TWO_LAPS, QUICK // 2, variance=ring.per_step)
    assert plain.mean_nees(1.0, 2.0) > 5 * BAND[1]
    assert BAND[0] < rough.mean_nees(0.0, 1.0) < BAND[1]
    assert rough.mean_nees(1.0, 2.0) < 1.25 * BAND[1]


def test_iterating_the_closure_keeps_it_consistent(rough):
    short = ring.make_course(laps=1.1)
    once = ring.monte_carlo(RIEKF, short, QUICK, variance=ring.per_step, iterate=False)
    assert once.nees[:, once.closure].mean() > 1.5 * BAND[1]
    assert rough.nees[:, rough.closure].mean() < 1.25 * BAND[1]


@pytest.mark.parametrize("expected", [True, False])
def test_contacts_stay_consistent_and_a_filter_that_ignores_them_does_not(expected):
    """A contact in every eighth step, with or without the bumper flag that announces the slip to the filter."""
    rng = np.random.default_rng(7)
    sigma = SLIP * expected
    config = FilterConfig(bumper_lateral_sigma_m=sigma[0], bumper_heading_sigma_deg=np.degrees(sigma[1]))
    steps = len(ring.straight_and_turn(0.25, 1))
    slips = SLIP * rng.normal(size=(QUICK, steps, 2)) * (np.arange(steps) % 8 == 0)[:, None]
    runs = ring.monte_carlo(config, [ring.make_course(laps=1, slips=s) for s in slips], QUICK)
    if expected:
        assert BAND[0] < runs.mean_nees(0.0, 1.0) < BAND[1]
    else:
        assert runs.mean_nees(0.0, 1.0) > 2 * BAND[1]


def test_a_biased_model_fails(monkeypatch):
    """Odometry that turns 0.03 rad a metre too far is caught by the test that the true model passes."""

    def biased(increments, cov, bumper):
        return make.odometry(increments + [0.0, 0.03] * np.abs(increments[:, :1]), cov=cov, bumper=bumper)

    monkeypatch.setattr(ring, "Odometry", biased)
    assert ring.monte_carlo(RIEKF, ring.make_course(laps=1), QUICK // 2).mean_nees(0.0, 1.0) > BAND[1]


class Life:
    """A random sequence: motion, contacts, coarse and precise scans, landmarks that are added, removed and merged."""

    def __init__(self, kind: str) -> None:
        self.rng = np.random.default_rng(1)
        self.estimate = make_filter(FilterConfig(kind=kind))
        self.landmarks, self.room = ring.corners()
        self.T = np.zeros(3)
        self.corner_of: dict[int, int] = {}  # filter id -> true corner
        self.fresh = 0

    def move(self, k: int) -> None:
        arc = np.array([[0.15, 0.2 * self.rng.normal()]])
        self.T = ring.moved(self.T, arc[0, 0], 0.0, arc[0, 1])
        var = ring.per_metre(arc)
        measured = arc + self.rng.normal(size=(1, 2)) * np.sqrt(var)
        self.estimate.predict(make.odometry(measured, np.sqrt(var), bumper=k % 50 == 0))
        if np.abs(self.T[:2] - 6.0).max() > 8.0:
            self.T[2] = np.arctan2(6.0 - self.T[1], 6.0 - self.T[0])
            self.estimate.set_pose(self.T)

    def look(self, k: int) -> None:
        seen = np.flatnonzero(self.room == ring.nearest_room(self.T[:2]))
        id_of = {corner: landmark for landmark, corner in self.corner_of.items()}
        known = np.array([c in id_of for c in seen])
        sigma = np.array([0.05, 0.005] if k % 100 else [1e-4, 1e-5])
        z = ring.measure(self.T, self.landmarks[seen]) + self.rng.normal(size=(len(seen), 2)) * sigma
        ids = np.array([id_of[c] for c in seen[known]], np.int64)
        self.estimate.update(z[known], np.diag(np.tile(sigma**2, len(ids))), ids, iterate=k % 200 == 0)
        for corner, row in zip(seen[~known], z[~known], strict=True):
            self.take_in(row, sigma)
            self.corner_of[self.fresh - 1] = int(corner)
        if k % 300 == 299 and known.any():
            self.take_in(z[known][0], sigma)
            self.estimate.fuse(int(ids[0]), self.fresh - 1)

    def take_in(self, z: np.ndarray, sigma: np.ndarray) -> None:
        self.estimate.augment(z[None], np.diag(sigma**2), np.array([self.fresh]))
        self.fresh += 1

    def forget(self) -> None:
        gone = int(self.rng.choice(self.estimate.ids))
        self.estimate.remove(np.array([gone]))
        self.corner_of.pop(gone)

    def check(self) -> None:
        P = self.estimate.cov[: self.estimate.size, : self.estimate.size]
        assert np.isfinite(P).all()
        assert np.abs(P - P.T).max() <= 1e-12
        assert np.linalg.eigvalsh(P)[0] >= -1e-9


@cache
def lived(kind: str) -> Life:
    """A life of 10,000 steps."""
    return live(Life(kind), range(10_000), check_every=50)


def live(life: Life, steps: range, check_every: int) -> Life:
    for k in steps:
        life.move(k)
        life.look(k)
        if k % 170 == 169:
            life.forget()
        if k % check_every == 0:
            life.check()
    assert life.fresh > steps.stop / 200
    return life


def test_covariance_stays_symmetric_and_positive(kind):
    assert lived(kind)


@pytest.mark.slow
def test_covariance_stays_symmetric_and_positive_for_long(kind):
    live(copy.deepcopy(lived(kind)), range(10_000, 20_000), check_every=200)


PROGRAM = """
import hashlib
import numpy as np
from benchmarks import ring
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import make_filter
from tests.slam import make
for kind in ("riekf", "ekf", "fej"):
    estimate = make_filter(FilterConfig(kind=kind))
    for k, step in enumerate(ring.drive(np.random.default_rng(3), ring.make_course(), arcs_per_step=4)):
        ring.cycle(estimate, step, iterate=k % 50 == 0)
    print(hashlib.sha256(estimate.mean.tobytes() + estimate.cov.tobytes()).hexdigest())
"""


def test_same_bits_in_every_process_and_thread_setting():
    outputs = set()
    for threads in ("1", "2"):
        environment = os.environ | {"OPENBLAS_NUM_THREADS": threads, "OMP_NUM_THREADS": threads}
        command = [sys.executable, "-c", PROGRAM]
        printed = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
        outputs.add(tuple(line for line in printed.splitlines() if len(line) == 64))
    assert len(outputs) == 1
    assert len(outputs.pop()) == 3
