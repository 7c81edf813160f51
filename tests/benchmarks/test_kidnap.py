"""The scores of the benchmark `kidnap`, on constructed outcomes and on a short drive."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from benchmarks import kidnap
from benchmarks.drives import Drive
from benchmarks.records import Records
from mecp_env.evaluation.ground_truth import GroundTruth
from mecp_env.slam.config import SlamConfig
from tests.slam.drives import scripted_drive


def test_roc_area_is_the_share_of_pairs_in_the_right_order() -> None:
    confidence, error_m = np.array([0.9, 0.8, 0.3, 0.8, 0.1]), np.array([0.1, 0.1, 0.1, 2.0, 2.0])
    assert kidnap.roc_area(confidence, error_m) == pytest.approx((2 + 1.5 + 1) / 6)
    assert math.isnan(kidnap.roc_area(confidence[:3], error_m[:3]))
    sure = np.array([0.95] * 10 + [0.05] * 10)  # the gap between confidence and frequency
    assert kidnap.calibration_error(sure, np.array([0.1] * 10 + [2.0] * 10)) == pytest.approx(0.05)
    assert kidnap.calibration_error(sure, np.array([2.0] * 10 + [0.1] * 10)) == pytest.approx(0.95)


@pytest.mark.slow
def test_events_are_counted_and_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    made = scripted_drive()
    drive = Drive(GroundTruth(made.outline, 30.0), SlamConfig(), made.odometry, made.scans, made.T_world_robot)
    monkeypatch.setattr(Records, "drive", lambda *_: drive)
    rows = [f"two_rooms {method}".strip() for method in kidnap.METHODS]
    figures = {row: kidnap.summarise([kidnap.disturb((row, 3, 0))] * 2) for row in rows}
    for row, kind in itertools.product(rows, kidnap.KINDS):
        cell = figures[row][kind]
        assert (cell["events"], cell["noticed"]["value"], cell["right_at_end"]["value"]) == (6, 1.0, 1.0)
        assert (cell["wrong_poses"], len(cell["right_after"])) == (0, len(kidnap.SHOWN))
    assert figures["two_rooms"]["confidence"]["false_alarms"]["value"] == 0.0
    assert all(f"| {row} | carried |" in kidnap.report(figures) for row in rows)
