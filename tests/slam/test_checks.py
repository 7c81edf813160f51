"""The checks of scans and odometry: what the kernels find, and what a plain twin finds."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mecp_env.slam.checks import NOT_FINITE, OUT_OF_ORDER, OUT_OF_RANGE, SOUND, find_fault, look_over

MAX_RANGE_M = 30.0
DAMAGE = (math.nan, math.inf, -math.inf, -1e-9, 0.0, MAX_RANGE_M, 30.1, -math.pi, math.pi, 3.2, -3.2)


def fault_of(ranges, bearings, max_range):
    """The plain twin of `find_fault`: beam by beam."""
    for sweep, sweep_bearings in zip(ranges.tolist(), bearings.tolist(), strict=True):
        last = -math.inf
        for r, bearing in zip(sweep, sweep_bearings, strict=True):
            if not (math.isfinite(r) and math.isfinite(bearing)):
                return NOT_FINITE
            if r < 0.0 or r > max_range:
                return OUT_OF_RANGE
            if not (last < bearing and -math.pi <= bearing <= math.pi):
                return OUT_OF_ORDER
            last = bearing
    return SOUND


@pytest.mark.parametrize("max_range", [MAX_RANGE_M, math.inf, math.nan])
@pytest.mark.parametrize("beams", [1, 2, 37])
def test_the_fault_of_a_scan_is_that_of_the_plain_twin(beams, max_range):
    rng, found = np.random.default_rng(0), set()
    for case in range(400):
        ranges = rng.uniform(0.0, MAX_RANGE_M, (3, beams))
        bearings = np.sort(rng.uniform(-math.pi, math.pi, (3, beams)))
        for damaged in (ranges, bearings)[: case % 3]:
            damaged[rng.integers(3), rng.integers(beams)] = rng.choice(DAMAGE)
        found.add(fault_of(ranges, bearings, max_range))
        assert find_fault(ranges, bearings, max_range) == fault_of(ranges, bearings, max_range)
    assert len(found) > 1


def test_odometry_is_looked_over():
    increments, cov = np.ones((3, 2)), np.tile(np.eye(2), (3, 1, 1))
    assert look_over(increments, cov) == (True, 0.0)
    assert look_over(np.empty((0, 2)), np.empty((0, 2, 2))) == (True, 0.0)
    cov[1, 0, 1] = -5.0
    cov[2, 1, 1] = -2.0
    assert look_over(increments, cov) == (True, -2.0)
    for array, place in ((increments, (2, 1)), (cov, (0, 1, 0)), (cov, (2, 0, 0))):
        array[place] = math.nan
        assert not look_over(increments, cov)[0]
        array[place] = 1.0
