"""The scores of the benchmark `kidnap`, on constructed outcomes and on a short drive."""

import math

import numpy as np
import pytest

from benchmarks.drives import calibration_error, roc_area


def test_roc_area_is_the_share_of_pairs_in_the_right_order() -> None:
    confidence, error_m = np.array([0.9, 0.8, 0.3, 0.8, 0.1]), np.array([0.1, 0.1, 0.1, 2.0, 2.0])
    assert roc_area(confidence, error_m) == pytest.approx((2 + 1.5 + 1) / 6)
    assert math.isnan(roc_area(confidence[:3], error_m[:3]))
    sure = np.array([0.95] * 10 + [0.05] * 10)  # the gap between confidence and frequency
    assert calibration_error(sure, np.array([0.1] * 10 + [2.0] * 10)) == pytest.approx(0.05)
    assert calibration_error(sure, np.array([2.0] * 10 + [0.1] * 10)) == pytest.approx(0.95)
