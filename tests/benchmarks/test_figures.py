"""The benchmark `figures`: the mean of Gaussians that it draws, and pictures with metres and legends, small enough."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from benchmarks import __main__ as command
from benchmarks import figures
from benchmarks.common import Options
from benchmarks.paper_plots import Centre, in_the_map, in_the_scan
from mecp_env.core.se2 import polar_to_points
from mecp_env.slam.pipeline import SlamPipeline
from tests.slam.drives import scripted_drive

MOST_BYTES = 300_000


def test_the_centre_of_independent_vertices_has_a_share_of_one_kth_of_their_variance() -> None:
    centre = Centre(np.eye(4, 2), np.diag([4.0, 1.0] * 4))
    assert centre.variance_share == pytest.approx(0.25)
    np.testing.assert_allclose(centre.mean_cov, np.diag([1.0, 0.25]))
    assert centre.sigmas_m == pytest.approx((np.sqrt(2.5), np.sqrt(0.625)))
    shared = Centre(np.eye(4, 2), np.kron(np.ones((4, 4)), np.diag([4.0, 1.0])))  # does not average out
    assert shared.variance_share == pytest.approx(1.0)
    np.testing.assert_allclose(shared.mean_cov, np.diag([4.0, 1.0]))


def test_both_frames_have_the_covariances_of_corners_and_landmarks() -> None:
    drive, pipeline = scripted_drive(), SlamPipeline()
    pipeline.start(drive.scans[0])
    for k in range(3, 20):
        output = pipeline.step(drive.odometry[k], drive.scans[k])
    index = output.polygons[0].corners
    scan, rng = in_the_scan(output.corners, index), np.random.default_rng(0)
    z, R = output.corners.measurements(index)
    sampled = rng.multivariate_normal(z.ravel(), R, 20_000)
    points = np.array([polar_to_points(one.reshape(-1, 2)).ravel() for one in sampled])
    np.testing.assert_allclose(scan.cov, np.cov(points.T), atol=0.05 * scan.cov.max())
    known = in_the_map(pipeline.filter, output.belief.ids[:5])
    np.testing.assert_allclose(known.points, output.belief.p_map[:5])
    np.testing.assert_allclose(known.blocks, output.belief.covs[:5])


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    for name, value in {"LAYOUT": "two_rooms", "FIRST_ROOMS": 1, "FIRST_SCANS": 8, "SPARSE_M": 0.04}.items():
        monkeypatch.setattr(figures, name, value)
    figures.gather.cache_clear()
    yield
    figures.gather.cache_clear()


@pytest.mark.slow
def test_every_picture_has_metres_a_legend_and_a_bounded_size(small: None, tmp_path: Path) -> None:
    pictures = figures.pictures(Options())
    assert list(pictures) == [f"fig{number}" for number in range(2, 9)]
    assert all(picture.legends for name, picture in pictures.items() if name != "fig8")  # a frame has its own
    for picture in list(pictures.values())[:5]:  # the others are of the package
        assert {(axes.get_xlabel(), axes.get_ylabel()) for axes in picture.axes} == {("x (m)", "y (m)")}
    command.save_pictures(pictures, tmp_path / "figures")
    written = sorted((tmp_path / "figures").iterdir())
    assert len(written) == 14
    assert max(path.stat().st_size for path in written) < MOST_BYTES
    measured = figures.run(Options())
    assert measured["fig3"]["hits_per_m"] > 3.0 * measured["fig2"]["hits_per_m"]
    assert measured["fig4"]["scan"]["share"] < 0.5
    assert f"Figure 8: {figures.TITLES['fig8']}" in figures.report(measured)
