"""Does the covariance tell the truth? NEES over many runs, and positivity over many steps (maths 5)."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from mecp_env.slam.config import FilterConfig
from mecp_env.slam.data import Odometry
from mecp_env.slam.filters import make_filter
from tests.slam.filters import ring

BAND = (2.41, 3.65)  # 95 % of the mean of 60 NEES of 3 degrees of freedom
SLIP_SIGMA_M, SLIP_SIGMA_RAD = 0.05, np.radians(3.0)


@pytest.fixture(scope="module")
def riekf() -> ring.Figures:
    return ring.monte_carlo("riekf", runs=60)


def test_invariant_filter_is_consistent(riekf):
    assert BAND[0] < riekf.mean(0.0, 1.0) < BAND[1]
    assert BAND[0] < riekf.mean(1.0, 2.0) < BAND[1]
    assert BAND[0] < riekf.nees[:, riekf.closure].mean() < BAND[1]


def test_the_loop_is_closed_and_pays(riekf):
    before = np.sqrt((riekf.error_m[:, riekf.closure - 5] ** 2).mean())
    after = np.sqrt((riekf.error_m[:, riekf.closure] ** 2).mean())
    assert after < 0.5 * before


def test_arcs_within_a_period_add_up():
    assert BAND[0] < ring.monte_carlo("riekf", runs=60, arcs_per_step=4, laps=1).mean(0.0, 1.0) < BAND[1]


def test_plain_filter_is_not_consistent(riekf):
    plain = ring.monte_carlo("ekf", runs=20)
    assert plain.mean(1.0, 2.0) > 1.5 * BAND[1]
    assert plain.error_m.mean() > riekf.error_m[:20].mean()


def test_sigmas_per_short_step_break_the_plain_filter_only():
    """The literal reading of the paper's sigmas, with .25 m steps: the worst case of maths 5."""
    options = {"variance": ring.per_step, "runs": 30}
    assert ring.monte_carlo("ekf", **options).mean(1.0, 2.0) > 5 * BAND[1]
    invariant = ring.monte_carlo("riekf", **options)
    assert BAND[0] < invariant.mean(0.0, 1.0) < BAND[1]
    assert invariant.mean(1.0, 2.0) < 1.5 * BAND[1]


def test_iterating_the_closure_keeps_it_consistent():
    options = {"variance": ring.per_step, "runs": 60, "laps": 2}
    once, iterated = (ring.monte_carlo("riekf", iterate_closure=iterate, **options) for iterate in (False, True))
    assert once.nees[:, once.closure].mean() > 1.5 * BAND[1]
    assert BAND[0] < iterated.nees[:, iterated.closure].mean() < BAND[1]


def slips(seed: int):
    """A contact in every eighth step, with the slip that the filter's configuration expects."""
    rng = np.random.default_rng(1000 + seed)

    def slip(k: int) -> tuple[float, float]:
        lateral, turn = rng.normal(size=2) * [SLIP_SIGMA_M, SLIP_SIGMA_RAD]
        return (float(lateral), float(turn)) if k % 8 == 0 else (0.0, 0.0)

    return slip


@pytest.mark.parametrize("sliding", [True, False])
def test_contacts_stay_consistent_and_a_filter_that_ignores_them_does_not(sliding):
    known = {"bumper_lateral_sigma_m": SLIP_SIGMA_M, "bumper_heading_sigma_deg": 3.0} if sliding else {
        "bumper_lateral_sigma_m": 0.0, "bumper_heading_sigma_deg": 0.0}  # fmt: skip
    figures = ring.monte_carlo("riekf", runs=40, config=known, laps=1, slip=slips(0))
    if sliding:
        assert BAND[0] < figures.mean(0.0, 1.0) < BAND[1]
    else:
        assert figures.mean(0.0, 1.0) > 2 * BAND[1]


def test_a_biased_model_fails(monkeypatch):
    """Odometry that turns 3 % of the way too far is caught by the same test that the true model passes."""
    true_odometry = Odometry

    def biased(increments, cov, bumper):
        return true_odometry(increments + [0.0, 0.03] * np.abs(increments[:, :1]), cov, bumper)

    monkeypatch.setattr(ring, "Odometry", biased)
    assert ring.monte_carlo("riekf", runs=20, laps=1).mean(0.0, 1.0) > BAND[1]


class Life:
    """A random life: motion, contacts, coarse and precise scans, landmarks that come, go and are fused."""

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
        self.estimate.predict(Odometry(measured, var[:, :, None] * np.eye(2), k % 50 == 0))
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


def live(kind: str, steps: int, check_every: int) -> None:
    life = Life(kind)
    for k in range(steps):
        life.move(k)
        life.look(k)
        if k % 170 == 169:
            life.forget()
        if k % check_every == 0:
            life.check()
    assert life.fresh > steps / 200


def test_covariance_stays_symmetric_and_positive(kind):
    live(kind, steps=10_000, check_every=50)


@pytest.mark.slow
def test_covariance_stays_symmetric_and_positive_for_long(kind):
    live(kind, steps=100_000, check_every=200)


PROGRAM = """
import hashlib
from tests.slam.filters import ring
figures = ring.monte_carlo("riekf", runs=1, laps=1)
print(hashlib.sha256(figures.nees.tobytes() + figures.error_m.tobytes()).hexdigest())
from mecp_env.slam.filters import make_filter
from mecp_env.slam.config import FilterConfig
import numpy as np
for kind in ("riekf", "ekf"):
    estimate = make_filter(FilterConfig(kind=kind))
    for step in ring.drive(np.random.default_rng(3), arcs_per_step=4):
        ring.cycle(estimate, step, iterate=True)
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
