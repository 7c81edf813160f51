"""OpenKarto as a rival on logs; its runs need the extra `lab`."""

import numpy as np
import pytest

from benchmarks import karto
from mecp_env.core.se2 import between
from mecp_env.evaluation.trajectory import trajectory_error
from mecp_env.logs.log import Log
from tests.slam.drives import scripted_drive

needs_karto = pytest.mark.skipif(not karto.installed(), reason="extra `lab`")
RELATION = np.array([[0.0, 1.0, 1.0, 0.0, 0.0]])
PATH = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])


def line(path: np.ndarray) -> Log:
    return Log(
        "line", np.arange(3.0), np.ones((3, 4)), np.linspace(-1.0, 1.0, 4), 5.0, np.zeros(3), path, path, RELATION
    )


def test_both_paths_are_scored_by_the_names_of_the_estimator():
    off = PATH.copy()
    off[1, 0] += 0.1
    found = karto.figures(line(PATH), np.arange(3), karto.KartoRun(off, PATH, 2.0, 1))
    assert found["karto_final_ate_m"] == pytest.approx(0.0, abs=1e-9)
    assert found["karto_ate_m"] > 0.03
    assert found["karto_relations_m"] == found["karto_relations_at_scans_m"] == pytest.approx(0.1)
    assert (found["karto_ms_per_scan_mean"], found["karto_loops"]) == (2.0, 1)


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
