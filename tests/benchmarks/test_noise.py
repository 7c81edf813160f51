"""The benchmark `noise`: scans that are cut as a poorer laser would take them, and the figures of one drive."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from benchmarks import noise, records
from benchmarks.common import Options
from benchmarks.drives import Drive, record_drive, replay
from benchmarks.variants import with_change
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


@pytest.fixture(scope="module")
def drive() -> Drive:
    return record_drive("two_rooms", 0, estimator="truth", max_steps=80)


@pytest.mark.parametrize("every", [2, 4, 8])
def test_every_nth_beam_is_the_scan_of_a_laser_with_fewer_beams(every: int) -> None:
    thin, coarse = noise.thinned(scan(720), every), scan(720 // every)
    np.testing.assert_allclose(thin.bearings, coarse.bearings, atol=1e-12)
    np.testing.assert_allclose(thin.ranges, coarse.ranges, atol=1e-9)
    np.testing.assert_array_equal(thin.hit, coarse.hit)


def test_a_field_of_view_is_ahead_and_loses_the_other_beams() -> None:
    whole, half = scan(720), noise.narrowed(scan(720), 180.0)
    assert half.ranges.shape == half.hit.shape == half.bearings.shape
    assert half.bearings.shape[1] == pytest.approx(360, abs=1)
    assert np.abs(half.bearings).max() < np.radians(90.5)
    inside = np.abs(whole.bearings[0]) <= np.pi / 2
    np.testing.assert_array_equal(half.ranges, whole.ranges[:, inside])


@pytest.mark.parametrize("view", [270, 180])
def test_a_cut_scan_is_the_scan_of_a_laser_with_that_field_of_view(view: int) -> None:
    cut, simulated = noise.narrowed(scan(720), view), scan(2 * view, view)
    np.testing.assert_allclose(cut.bearings, simulated.bearings, atol=1e-12)
    np.testing.assert_allclose(cut.ranges, simulated.ranges, atol=1e-9)


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


def test_every_cell_has_drives_a_gate_its_figure_and_the_figure_its_cells() -> None:
    assert set(noise.DRIVES) == set(noise.CELLS)
    assert {gate.path.split("/")[0] for gate in noise.GATES} <= set(noise.CELLS)
    assert {cell for cells in noise.AXES.values() for cell in cells} == set(noise.CELLS)
    assert {noise.source(cell) for cell in noise.CELLS} == set(noise.RECORDED)


def test_every_variant_gives_all_figures_on_the_same_drive(drive: Drive, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(noise, "recorded", lambda *_: drive)
    figures = {
        cell: {name: noise.summarise([row, row]) for name, row in noise.compare((cell, 0)).items()}
        for cell in ("odometry_x1", "view_180_deg")
    }
    default = figures["odometry_x1"]["mecp"]
    assert default["precision"]["value"] > 0.99
    assert default["rmse_m"]["value"] < 0.05
    assert default["lost"]["value"] == 0.0
    assert default["associate_ms"]["value"] > 0.0
    assert figures["odometry_x1"]["known"]["precision"]["value"] == 1.0
    assert figures["view_180_deg"]["mecp"] != default
    page = noise.report(figures)
    assert "## view_180_deg (2 drives)" in page
    assert all(f"| {variant} |" in page for variant in noise.VARIANTS)
    assert [axes.get_title() for axes in noise.figure(figures).axes] == list(noise.AXES)
    assert {gate.path.split("/")[2] for gate in noise.GATES} <= default.keys()


def test_corners_near_the_end_of_the_range_are_counted(drive: Drive) -> None:
    near = record_drive("two_rooms", 0, estimator="truth", max_steps=40, laser={"max_range_m": 4.0})
    outcome = replay(near, with_change(near.slam, {}))
    assert 0 <= outcome.phantoms <= outcome.far
    assert replay(drive, with_change(drive.slam, {})).far == 0  # no wall is 28 m away


def test_cells_of_one_recording_follow_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, int]] = []
    noted = lambda task, kind, units, options: asked.extend(units) or [{}] * len(units)  # noqa: E731
    monkeypatch.setattr(records, "in_parallel", noted)
    monkeypatch.setattr(noise, "summarise", lambda drives: {})
    monkeypatch.setattr(noise, "VARIANTS", {})
    assert set(noise.run(Options(quick=True))) == set(noise.CELLS)
    sources = [(seed, noise.source(cell)) for cell, seed in asked]
    changes = sum(a != b for a, b in pairwise(sources))
    assert changes == len(set(sources)) - 1
    assert len(asked) == 2 * len(noise.CELLS)
