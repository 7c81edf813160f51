"""The batch optimum of GTSAM against SciPy, and the benchmarks that use it."""

import sys
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from benchmarks import consistency, known_pairs, ring, victoria_park
from benchmarks.batch import measurement, optimum
from benchmarks.common import OptionError, Options, shared_data
from benchmarks.known_pairs import Motion, Record, Sighting, filtered, turned
from mecp_env.core.se2 import compose, inverse
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import make_filter
from mecp_env.slam.filters.models import left_jacobian
from tests.slam import make

LOG = (shared_data("logs") or Path("none")) / victoria_park.FILE
needs_gtsam = pytest.mark.skipif("not __import__('importlib.util').util.find_spec('gtsam')", reason="extra `lab`")
needs_log = pytest.mark.skipif(not LOG.is_file(), reason="no Victoria Park in shared/data/logs")


def ring_record(steps: int) -> Record:
    """The first steps round the ring of rooms, with correlated corners; the first scan is taken at rest."""
    config, rng = FilterConfig(), np.random.default_rng(0)
    motions, sightings = list[Motion](), [Sighting(np.empty((0, 2)), np.empty((0, 0)), np.empty(0, np.int64))]
    for odometry, seen in islice(ring.drive(rng, ring.make_course()), steps):
        arcs = make.odometry(
            np.tile(odometry.increments / 4.0, (4, 1)), cov=odometry.cov[0] / 4.0
        )  # sideways noise, too
        motions.append(Motion.of_odometry(arcs, config))
        common = 0.2 * np.sqrt(np.diag(seen.R))
        sightings.append(Sighting(seen.z, seen.R + np.outer(common, common), seen.ids))
    return Record(np.zeros(3), np.diag([1e-6, 1e-6, 1e-8]), motions, sightings)


def run_filter(record: Record, kind: str = "riekf") -> tuple[np.ndarray, Any]:
    estimate = make_filter(FilterConfig(kind=kind))
    path = np.array([belief.T_map_robot for belief in filtered(record, estimate, victoria_park.corrected)])
    return path, estimate.belief()


def least(record: Record, path: np.ndarray, p_map: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Path, landmarks and their covariances by SciPy, dense; the landmarks are 0, 1, ..."""
    count = len(path)

    def residuals(x: np.ndarray) -> np.ndarray:
        poses, points = x[: 3 * count].reshape(-1, 3), x[3 * count :].reshape(-1, 2)
        parts = [whitened(record.start_cov, logarithm(compose(inverse(record.start), poses[0])))]
        for k, motion in enumerate(record.motions):
            moved = compose(inverse(poses[k]), poses[k + 1])
            parts.append(whitened(motion.cov, logarithm(compose(inverse(motion.T), moved))))
        for pose, sighting in zip(poses, record.sightings, strict=True):
            if len(sighting.ids):
                parts.append(whitened(sighting.R, measurement(pose, points[sighting.ids], sighting.z)[0]))
        return np.concatenate(parts)

    best = least_squares(residuals, np.concatenate([path.ravel(), p_map.ravel()]), xtol=1e-15, ftol=1e-15, gtol=1e-12)
    cov = np.linalg.inv(best.jac.T @ best.jac)[3 * count :, 3 * count :]
    return best.x, cov, 2.0 * best.cost


def logarithm(T: np.ndarray) -> np.ndarray:
    """The twist of a pose, as GTSAM has the error of a motion."""
    a, b = left_jacobian(T[2])
    return np.array([*np.linalg.solve([[a, -b], [b, a]], T[:2]), T[2]])


def whitened(cov: np.ndarray, error: np.ndarray) -> np.ndarray:
    return np.linalg.solve(np.linalg.cholesky(cov), error)


@pytest.mark.slow
@needs_gtsam
def test_the_optimum_is_that_of_scipy() -> None:
    record = ring_record(30)
    path, belief = run_filter(record)
    count = len(belief.ids)
    to_row = np.argsort(belief.ids)
    assert count >= 8
    assert belief.ids[to_row].tolist() == list(range(count))
    best = optimum(record, path, belief.ids, belief.p_map)
    x, cov, chi2 = least(record, path, belief.p_map[to_row])
    assert best.chi2 == pytest.approx(chi2, rel=1e-6)
    np.testing.assert_allclose(best.T_map_robot, x[: path.size].reshape(-1, 3), atol=1e-6)
    np.testing.assert_allclose(best.p_map, x[path.size :].reshape(-1, 2), atol=1e-6)
    for k in range(count):
        np.testing.assert_allclose(best.covs[k], cov[2 * k : 2 * k + 2, 2 * k : 2 * k + 2], rtol=1e-3, atol=1e-9)
    measured = sum(2 * len(sighting.ids) for sighting in record.sightings)
    assert best.freedom == measured - 2 * count
    assert 0.5 < best.chi2 / best.freedom < 1.5
    other = optimum(record, path + 0.05, belief.ids, belief.p_map + 0.1)  # no start near by changes it
    assert other.chi2 == pytest.approx(best.chi2, rel=1e-9)
    np.testing.assert_allclose(other.p_map, best.p_map, atol=1e-6)


def test_derivatives_are_those_of_finite_differences() -> None:
    rng = np.random.default_rng(1)
    T, points, z = np.array([1.0, -2.0, 0.7]), rng.uniform(3.0, 8.0, (4, 2)), np.zeros((4, 2))
    _, by_pose, by_point = measurement(T, points, z)
    numeric = make.slopes(lambda step: measurement(compose(T, step), points, z)[0], np.zeros(3))
    np.testing.assert_allclose(by_pose.reshape(-1, 3), numeric, atol=1e-7)
    numeric = make.slopes(lambda shift: measurement(T, points + shift, z)[0], np.zeros(2))
    np.testing.assert_allclose(by_point.reshape(-1, 2), numeric, atol=1e-7)


def test_a_motion_is_what_a_filter_predicts() -> None:
    """Predicted from any pose: the same pose, and the same covariance but for the floor of rest."""
    odometry = make.odometry([(0.3, 0.4), (0.2, -0.1)], cov=np.diag([0.01, 0.02]))
    motion, estimate = Motion.of_odometry(odometry, FilterConfig()), make_filter(FilterConfig(kind="ekf"))
    estimate.set_pose(np.array([2.0, 1.0, 0.8]))
    before = estimate.belief().T_map_robot
    estimate.predict(odometry)
    after = estimate.belief()
    np.testing.assert_allclose(after.T_map_robot, compose(before, motion.T), atol=1e-12)
    np.testing.assert_allclose(after.pose_cov, turned(motion.cov, after.T_map_robot[2]), atol=1e-8)


@pytest.mark.parametrize("kind", ["riekf", "ekf", "fej"])
def test_noise_that_the_odometry_lacks_is_added_by_every_filter(kind: str) -> None:
    T, cov = np.array([1.0, 0.1, 0.3]), np.diag([1e-4, 4e-6, 4e-6])
    motion = victoria_park.motion_of(T, cov)
    nothing = Sighting(np.empty((0, 2)), np.empty((0, 0)), np.empty(0, np.int64))
    record = Record(np.array([1.0, 2.0, 0.5]), np.eye(3) * 1e-18, [motion], [nothing, nothing])
    *_, after = filtered(record, make_filter(FilterConfig(kind=kind)), victoria_park.corrected)
    np.testing.assert_allclose(after.T_map_robot, compose(record.start, T), atol=1e-12)
    np.testing.assert_allclose(after.pose_cov, turned(cov, 0.8), atol=1e-12)


def test_a_missing_gtsam_and_a_missing_log_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(victoria_park, "shared_data", lambda kind: None)
    with pytest.raises(OptionError, match=r"no victoria_park.npz in shared/data/logs"):
        victoria_park.run(Options())
    monkeypatch.setitem(sys.modules, "gtsam", None)
    with pytest.raises(OptionError, match=r"needs GTSAM: pip install -e '.\[lab\]'"):
        optimum(Record(np.zeros(3), np.eye(3), [], []), np.zeros((1, 3)), np.empty(0, np.int64), np.empty((0, 2)))


@needs_gtsam
@needs_log
@pytest.mark.slow
def test_victoria_park_as_it_is_known() -> None:
    """Chi2 6,347 at 6,978 degrees of freedom; the plain EKF is more than 10 m off, the consistent filters are not."""
    record = victoria_park.read(LOG)
    assert len(record.sightings) == len(record.motions) + 1 == 6969
    assert sum(len(sighting.ids) for sighting in record.sightings) == 3640
    figures = victoria_park.run(Options())
    assert figures["batch"]["chi2"] == pytest.approx(6347.0, abs=1.0)
    assert figures["batch"]["freedom"] == 6978
    assert figures["filters"]["riekf"]["once"]["landmark_rms_m"] == pytest.approx(1.35, abs=0.01)
    assert figures["filters"]["fej"]["once"]["landmark_rms_m"] < 1.25
    assert figures["filters"]["ekf"]["once"]["landmark_rms_m"] > 10.0


def test_only_steps_with_slip_are_allowed_more() -> None:
    assert consistency.band(60) == (pytest.approx(2.41, abs=0.01), pytest.approx(3.65, abs=0.01))
    motion = Motion(make.odometry((1.0, 0.0)), np.array([1.0, 0.0, 0.0]), np.eye(3) * 1e-4)
    assert known_pairs.with_slip(motion, np.array([1.01, 0.01, 0.0])) is motion
    slipped = known_pairs.with_slip(motion, np.array([0.4, 0.0, 0.1]))
    np.testing.assert_allclose(slipped.cov, motion.cov + np.diag(known_pairs.SLIP_SIGMAS**2))
    assert slipped.lacking is None
