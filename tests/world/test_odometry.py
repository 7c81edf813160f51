"""The odometry: noise as large as its covariance, in each reading; positive at rest."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mecp_env.world.config import OdometryConfig
from mecp_env.world.odometry import measure
from mecp_env.world.simulation import Motion
from tests.world.make import motion as moved

Array = NDArray[np.float64]

STRAIGHT = moved((0.1, 0.0), steps=4)
TURNING = moved((0.0, math.pi / 8.0), steps=4)
CURVE = moved((0.08, 0.1), steps=4)
MIXED = moved((0.05, 0.1), (0.1, -0.2), (-0.02, 0.0), (0.0, 0.0), contact=True)
REST = moved((0.0, 0.0), steps=4)


def fixed(noise: Any = 1.0) -> Any:
    """A generator that draws this noise, in sigmas."""
    return SimpleNamespace(standard_normal=lambda shape: np.broadcast_to(noise, shape).copy())


def sigmas(motion: Motion, config: OdometryConfig) -> Array:
    """Sigmas (M,2) of distance and turn of each increment by the configured reading."""
    return measure(motion, config, fixed()).increments - motion.increments


METRE = moved((0.25, 0.0), steps=4)
PAPERS = np.array([0.1, math.radians(1.5)])


@pytest.mark.parametrize(
    ("reading", "motion", "expected"),
    [
        ("per_metre", METRE, PAPERS),
        ("per_metre", TURNING, math.sqrt(0.5) * PAPERS),  # a quarter turn counts half a metre
        ("per_step", STRAIGHT, PAPERS),  # in every step with motion
        ("per_step", REST, [0.0, 0.0]),
        ("linear", STRAIGHT, [0.04, math.radians(0.6)]),  # grows with the way
        ("linear", TURNING, [0.0, math.radians(1.5)]),
    ],
)
def test_per_metre_is_the_papers_noise_after_a_metre(reading: str, motion: Motion, expected: Array) -> None:
    """And the other readings; of the whole distance and turn of a step."""
    found = np.hypot.reduce(sigmas(motion, OdometryConfig(reading=reading)))
    assert found == pytest.approx(np.asarray(expected), abs=1e-5)


@pytest.mark.parametrize("reading", ["per_metre", "per_step", "linear"])
@pytest.mark.parametrize("motion", [STRAIGHT, TURNING, MIXED, REST])
def test_the_noise_is_what_the_reading_says_and_the_covariance_covers_it(reading: str, motion: Motion) -> None:
    config, rng = OdometryConfig(reading=reading), np.random.default_rng(1)
    samples = [measure(motion, config, rng) for _ in range(2000)]
    errors = np.array([sample.increments - motion.increments for sample in samples])
    assert (errors**2).mean(axis=0) == pytest.approx(sigmas(motion, config) ** 2, rel=0.15)
    assert samples[0].bumper == motion.contact
    cov, errors = np.array([sample.cov.sum(axis=0) for sample in samples]), errors.sum(axis=1)
    assert (np.linalg.eigvalsh(cov) > 0.0).all()
    nis = np.einsum("si,sij,sj->s", errors, np.linalg.inv(cov), errors)
    assert nis.mean() < 2.4  # 2 expected; small readings overstate the way
    assert nis.mean() > 0.9 or motion is REST  # at rest there is no error


def test_the_covariance_knows_the_reading_alone() -> None:
    """The truth must not reach the filter: equal readings carry equal covariances, whatever the true motion was."""
    config = OdometryConfig()
    one, two = (
        measure(m, config, fixed((STRAIGHT.increments - m.increments) / sigmas(m, config))) for m in (STRAIGHT, CURVE)
    )
    assert one.increments == pytest.approx(two.increments)
    assert one.cov == pytest.approx(two.cov)


def test_scale_nought_is_perfect_odometry() -> None:
    odometry = measure(MIXED, OdometryConfig(scale=0.0), np.random.default_rng(2))
    assert odometry.increments == pytest.approx(MIXED.increments, abs=1e-5)
