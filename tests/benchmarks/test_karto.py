"""OpenKarto as a rival on logs; its runs need the extra `lab`."""

import numpy as np
import pytest

from benchmarks import karto
from benchmarks.common import is_installed
from mecp_env.core.se2 import between
from mecp_env.evaluation.trajectory import trajectory_error
from mecp_env.logs.log import Log
from tests.slam.drives import scripted_drive

needs_karto = pytest.mark.skipif(not is_installed(karto.PACKAGE), reason="extra `lab`")


@needs_karto
def test_it_corrects_a_drifting_odometry():
    drive = scripted_drive()
    scans, truth = drive.scans[:120:6], np.array(drive.T_world_robot[:120:6])
    ranges = np.array([np.where(scan.hit[0], scan.ranges[0], np.nan) for scan in scans])
    reference = between(np.broadcast_to(truth[0], truth.shape), truth)
    odometry = reference * [1.05, 1.05, 1.0] + np.linspace(0.0, 0.05, len(truth))[:, None] * [0.0, 0.0, 1.0]
    t, laser = np.arange(float(len(truth))), scans[0]
    log = Log("drive", t, ranges, laser.bearings[0], laser.max_range_m, np.zeros(3), odometry, reference)
    rows = np.arange(len(truth))
    found = karto.figures(log, rows, karto.run(log, rows, odometry))
    assert found["karto_ate_m"] < 0.25 * trajectory_error(odometry, reference).rmse_m
