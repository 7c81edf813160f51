"""The dense scan: interleaved sweeps become one beam per nominal bearing."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mecp_env.slam.frontend.scan import merge_sweeps
from tests.slam import make
from tests.slam.make import MAX_RANGE_M
from tests.slam.scans import LMS200, PAPER, ROOM, blank_scan, chain, take_scan


def test_one_sweep_stays_as_it_is():
    scan = take_scan(ROOM, sweeps=1)
    beams = merge_sweeps(scan, PAPER)
    np.testing.assert_array_equal(beams.ranges, scan.ranges[0])
    np.testing.assert_array_equal(beams.bearings, scan.bearings[0])
    assert (beams.count == 1).all()
    assert beams.hit.all()


def test_raw_beams_are_all_there_in_order_of_bearing():
    scan = take_scan(ROOM)
    beams = merge_sweeps(scan, PAPER)
    assert (np.diff(beams.raw_bearings) > 0).all()
    np.testing.assert_array_equal(np.sort(beams.raw_ranges), np.sort(scan.ranges.ravel()))


def test_sweeps_that_do_not_interleave_in_order_are_sorted():
    scan = take_scan(ROOM)
    shuffled = make.scan(scan.ranges[[2, 0, 3, 1]], scan.bearings[[2, 0, 3, 1]])
    np.testing.assert_array_equal(merge_sweeps(shuffled, PAPER).ranges, merge_sweeps(scan, PAPER).ranges)


def test_a_wall_is_averaged_over_all_sweeps():
    scan = take_scan(ROOM, LMS200)
    beams = merge_sweeps(scan, LMS200)
    whole = beams.count == 4
    assert whole.mean() > 0.99
    np.testing.assert_allclose(beams.ranges[whole], scan.ranges.mean(axis=0)[whole])
    np.testing.assert_allclose(beams.bearings[whole], scan.bearings.mean(axis=0)[whole])


def test_the_average_has_a_quarter_of_the_variance():
    wall = chain((2.0, -4.0), (2.0, 4.0))
    square = [
        np.square(merge_sweeps(take_scan(wall, seed=seed), PAPER).ranges[358:362] - 2.0).mean() for seed in range(300)
    ]
    assert np.mean(square) == pytest.approx(0.05**2 / 4, rel=0.15)


@pytest.mark.parametrize(
    ("ranges", "expected", "count"),
    [
        ((2.0, 2.02, 5.0, 2.01), 2.01, 3),  # the larger group
        ((2.0, 5.0, 5.02, 5.01), 5.01, 3),
        ((5.0, 2.0, 5.02, 2.02), 2.01, 2),  # the nearer one of equal groups
        ((2.0, 2.2, 2.05, 2.1), 2.0875, 4),  # noise
    ],
)
def test_beams_of_two_surfaces_are_told_apart(ranges, expected, count):
    beams = merge_sweeps(make.scan(np.repeat(np.array(ranges)[:, None], 720, axis=1)), PAPER)
    np.testing.assert_allclose(beams.ranges, expected)
    assert (beams.count == count).all()


def test_the_bearing_is_that_of_the_beams_used():
    scan = take_scan(ROOM)
    ranges = scan.ranges.copy()
    ranges[3, 100] = 12.0
    beams = merge_sweeps(make.scan(ranges), PAPER)
    assert beams.bearings[100] == pytest.approx(scan.bearings[:3, 100].mean())


def test_rays_that_hit_nothing_stand_apart_from_hits():
    scan = take_scan(ROOM)
    hit = scan.hit.copy()
    hit[:3, 10], hit[:2, 20], hit[:, 30] = False, False, False
    beams = merge_sweeps(make.scan(scan.ranges, hit=hit), PAPER)
    assert [bool(beams.hit[i]) for i in (10, 20, 30)] == [False, True, False]
    assert [int(beams.count[i]) for i in (10, 20, 30)] == [3, 2, 4]
    assert beams.ranges[30] == MAX_RANGE_M


def test_a_burst_without_hits():
    for sweeps in (1, 4):
        beams = merge_sweeps(blank_scan(sweeps), PAPER)
        assert not beams.hit.any()
        assert (beams.ranges == MAX_RANGE_M).all()


def plain_merge(scan, sensor):
    """The same by sorting: split at the widest gap until none is left; keep the larger group, the nearer of equals."""
    sweeps, size = scan.ranges.shape
    ranges, bearings = scan.ranges.T.reshape(size, sweeps), scan.bearings.T.reshape(size, sweeps)
    slope = sensor.merge_slope * (np.ptp(bearings) / (size * sweeps - 1) + sensor.bearing_sigma_rad)
    merged = []
    for beam in range(size):
        order = np.argsort(ranges[beam], kind="stable")
        r, b = ranges[beam, order], bearings[beam, order]
        excess = np.diff(r) - slope * r[:-1] - sensor.noise_sigmas * sensor.range_sigma_m
        while len(r) > 1 and excess.max() > 0.0:
            k = int(np.argmax(excess)) + 1
            keep = slice(0, k) if k >= len(r) - k else slice(k, None)
            r, b = r[keep], b[keep]
            excess = np.diff(r) - slope * r[:-1] - sensor.noise_sigmas * sensor.range_sigma_m
        merged.append((r.mean(), b.mean(), len(r)))
    return np.array(merged).T


def test_a_plain_twin_agrees_on_cluttered_scans():
    rng = np.random.default_rng(3)
    for seed in range(5):
        posts = [chain(p, p + rng.normal(0.0, 0.3, 2)) for p in rng.uniform(-4.0, 4.0, (30, 2))]
        far = 8.0 * np.array([(math.cos(a), math.sin(a)) for a in np.linspace(0.0, 2.0 * math.pi, 40)])
        scan = take_scan(np.concatenate([*posts, chain(*far)]), seed=seed)
        beams = merge_sweeps(scan, PAPER)
        ranges, bearings, count = plain_merge(scan, PAPER)
        np.testing.assert_allclose(beams.ranges, ranges)
        np.testing.assert_allclose(beams.bearings, bearings)
        np.testing.assert_array_equal(beams.count, count)


def test_the_union_of_the_sweeps_is_every_beam():
    scan = take_scan(ROOM)
    beams = merge_sweeps(scan, PAPER, "union")
    assert (np.diff(beams.bearings) > 0).all()
    assert (beams.count == 1).all()
    order = np.argsort(scan.bearings.ravel())
    np.testing.assert_array_equal(beams.ranges, scan.ranges.ravel()[order])
    np.testing.assert_array_equal(beams.hit, scan.hit.ravel()[order])
    assert beams.step == pytest.approx(merge_sweeps(scan, PAPER).step / 4, rel=1e-3)
