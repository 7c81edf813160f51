"""Rivals: the relaxation of CLIPPER, and OpenKarto on logs, whose runs need the extra `lab`."""

import numpy as np
import pytest

from benchmarks import karto
from benchmarks.clipper import densest
from benchmarks.common import is_installed
from mecp_env.core.se2 import between
from mecp_env.evaluation.trajectory import trajectory_error
from mecp_env.logs.log import Log
from tests.slam.drives import scripted_drive


@pytest.mark.parametrize("seed", range(3))
def test_a_planted_clique_is_found(seed: int) -> None:
    rng, n, size = np.random.default_rng(seed), 40, 12
    joined = np.triu(rng.uniform(size=(n, n)) < 0.2, 1)
    planted = np.sort(rng.choice(n, size, replace=False))
    joined[np.ix_(planted, planted)] = np.triu(np.ones((size, size), np.bool_), 1)
    affinity = np.where(joined | joined.T, 1.0, 0.0)
    assert densest(affinity).tolist() == planted.tolist()


def test_what_is_selected_has_no_missing_edge_and_nothing_is_selected_of_nothing() -> None:
    rng = np.random.default_rng(7)
    joined = np.triu(rng.uniform(size=(25, 25)) < 0.5, 1)
    affinity = np.where(joined | joined.T, rng.uniform(0.5, 1.0, (25, 25)), 0.0)
    affinity = 0.5 * (affinity + affinity.T)
    chosen = densest(affinity)
    among = affinity[np.ix_(chosen, chosen)]
    assert (among[~np.eye(len(chosen), dtype=bool)] > 0.0).all()
    assert len(chosen) >= 3
    assert len(densest(np.zeros((0, 0)))) == 0
    assert len(densest(np.zeros((3, 3)))) == 1


@pytest.mark.skipif(not is_installed(karto.PACKAGE), reason="extra `lab`")
def test_openkarto_corrects_a_drifting_odometry() -> None:
    drive = scripted_drive()
    scans, truth = drive.scans[:120:6], np.array(drive.T_world_robot[:120:6])
    ranges = np.array([np.where(scan.hit[0], scan.ranges[0], np.nan) for scan in scans])
    reference = between(np.broadcast_to(truth[0], truth.shape), truth)
    odometry = reference * [1.05, 1.05, 1.0] + np.linspace(0.0, 0.05, len(truth))[:, None] * [0.0, 0.0, 1.0]
    t, laser = np.arange(float(len(truth))), scans[0]
    log = Log("drive", t, ranges, laser.bearings[0], laser.max_range_m, np.zeros(3), odometry, reference)
    rows = np.arange(len(truth))
    found = karto.figures(log, rows, odometry)
    assert found["karto_ate_m"] < 0.25 * trajectory_error(odometry, reference).rmse_m
