"""The benchmark `noise`: scans that are cut as a poorer laser would take them, and the figures of one drive."""

from collections.abc import Callable

import numpy as np
import pytest

from benchmarks import noise
from benchmarks.drives import Drive
from mecp_env.core.sensors import Scan
from mecp_env.world.config import LaserConfig
from mecp_env.world.laser import Laser
from mecp_env.world.layout import load_layout
from mecp_env.world.outline import build_outline

POSE = np.array([2.0, 2.0, 0.4])


def scan(beams: int, view: float = 360.0) -> Scan:
    """A scan without noise."""
    config = LaserConfig(preset="ideal", beams=beams, max_range_m=30.0, field_of_view_deg=view)
    laser = Laser(build_outline(load_layout("two_rooms")), config)
    return laser.scan(POSE, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("changed", "beams", "view"),
    [
        (lambda whole: noise.thinned(whole, 4), 180, 360),
        (lambda whole: noise.narrowed(whole, 270), 540, 270),
        (lambda whole: noise.narrowed(whole, 180), 360, 180),
    ],
)
def test_a_scan_is_that_of_a_poorer_laser(changed: Callable[[Scan], Scan], beams: int, view: int) -> None:
    cut, poorer = changed(scan(720)), scan(beams, view)
    np.testing.assert_allclose(cut.bearings, poorer.bearings, atol=1e-12)
    np.testing.assert_allclose(cut.ranges, poorer.ranges, atol=1e-9)
    np.testing.assert_array_equal(cut.hit, poorer.hit)


def test_slip_changes_a_share_of_the_steps_the_same_ones_more_often(drive: Drive) -> None:
    def changed(share: float, seed: int = 3) -> set[int]:
        pairs = zip(drive.odometry, noise.slipped(drive, seed, share).odometry, strict=True)
        return {step for step, (old, new) in enumerate(pairs) if old is not new}

    assert changed(0.0) == set()
    assert changed(0.3) < changed(0.7)
    assert changed(0.3) == changed(0.3) != changed(0.3, seed=4)
    assert len(changed(1.0)) == len(drive.odometry) - drive.odometry.count(None)
    old, new = drive.odometry[-1], noise.slipped(drive, 3, 1.0).odometry[-1]
    assert old is not None
    assert new is not None
    factor = new.increments[:, 0].sum() / old.increments[:, 0].sum()
    assert 1.0 <= factor <= noise.SLIP_MOST
    np.testing.assert_allclose(np.diff(new.increments[:, 1]), np.diff(old.increments[:, 1]), atol=1e-12)
    assert new.cov is old.cov


def test_every_cell_has_drives_and_a_place_in_the_figure() -> None:
    assert {cell for cells in noise.AXES.values() for cell in cells} == set(noise.SETS)
    assert set(noise.SETS) == {*noise.RECORDED, *noise.CHANGED}
