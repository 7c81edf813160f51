"""The dense scan: interleaved sweeps become one beam per nominal bearing, and what lasers lose."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mecp_env.slam.config import ClusteringConfig, SensorModel
from mecp_env.slam.frontend.scan import longest_run
from tests.slam import make
from tests.slam.frontend.make import PAPER, front_end, merged, restored, stopped
from tests.slam.make import MAX_RANGE_M, nominal_bearings
from tests.slam.scans import LMS200, ROOM, cast, chain, take_scan

DARK = SensorModel(range_sigma_m=0.01, bearing_sigma_deg=0.0, dark_dropout=0.2)
SLANTING = SensorModel(range_sigma_m=0.01, bearing_sigma_deg=0.0, grazing_deg=80.0)


def test_sweeps_that_do_not_interleave_in_order_are_sorted():
    scan = take_scan(ROOM)
    beams = merged(make.scan(scan.ranges[[2, 0, 3, 1]], scan.bearings[[2, 0, 3, 1]]), PAPER)
    np.testing.assert_array_equal(beams.ranges, merged(scan, PAPER).ranges)
    assert (np.diff(beams.raw_bearings) > 0).all()
    np.testing.assert_array_equal(np.sort(beams.raw_ranges), np.sort(scan.ranges.ravel()))


def test_the_average_has_a_quarter_of_the_variance():
    wall = chain((2.0, -4.0), (2.0, 4.0))
    square = [np.square(merged(take_scan(wall, seed=seed), PAPER).ranges[358:362] - 2.0).mean() for seed in range(150)]
    assert np.mean(square) == pytest.approx(0.05**2 / 4, rel=0.15)


def test_rays_that_hit_nothing_stand_apart_from_hits():
    scan = take_scan(ROOM)
    hit = scan.hit.copy()
    hit[:3, 10], hit[:2, 20], hit[:, 30] = False, False, False
    beams = merged(make.scan(scan.ranges, hit=hit), PAPER)
    assert [bool(beams.hit[i]) for i in (10, 20, 30)] == [False, True, False]
    assert [int(beams.count[i]) for i in (10, 20, 30)] == [3, 2, 4]
    assert beams.ranges[30] == MAX_RANGE_M


def plain_merge(scan, sensor):
    """The same by sorting: split at the widest gap until none is left; keep the larger group, the nearer of equals."""
    sweeps, size = scan.ranges.shape
    ranges, bearings = scan.ranges.T.reshape(size, sweeps), scan.bearings.T.reshape(size, sweeps)
    slope = sensor.merge_slope * (np.ptp(bearings) / (size * sweeps - 1) + sensor.bearing_sigma_rad)
    kept, noise = [], sensor.noise_sigmas * sensor.range_sigma_m
    for beam in range(size):
        order = np.argsort(ranges[beam], kind="stable")
        r, b = ranges[beam, order], bearings[beam, order]
        while len(r) > 1 and (excess := np.diff(r) - slope * r[:-1] - noise).max() > 0.0:
            k = int(np.argmax(excess)) + 1
            keep = slice(0, k) if k >= len(r) - k else slice(k, None)
            r, b = r[keep], b[keep]
        kept.append((r.mean(), b.mean(), len(r)))
    return np.array(kept).T


def test_a_plain_twin_agrees_on_cluttered_scans():
    rng = np.random.default_rng(3)
    for seed in range(5):
        posts = [chain(p, p + rng.normal(0.0, 0.3, 2)) for p in rng.uniform(-4.0, 4.0, (30, 2))]
        far = 8.0 * np.array([(math.cos(a), math.sin(a)) for a in np.linspace(0.0, 2.0 * math.pi, 40)])
        scan = take_scan(np.concatenate([*posts, chain(*far)]), seed=seed)
        beams = merged(scan, PAPER)
        ranges, bearings, count = plain_merge(scan, PAPER)
        np.testing.assert_allclose(beams.ranges, ranges)
        np.testing.assert_allclose(beams.bearings, bearings)
        np.testing.assert_array_equal(beams.count, count)


def test_the_union_of_the_sweeps_is_every_beam():
    scan = take_scan(ROOM)
    beams = merged(scan, PAPER, ClusteringConfig(sweeps="union"))
    assert (np.diff(beams.bearings) > 0).all()
    assert (beams.count == 1).all()
    order = np.argsort(scan.bearings.ravel())
    np.testing.assert_array_equal(beams.ranges, scan.ranges.ravel()[order])
    np.testing.assert_array_equal(beams.hit, scan.hit.ravel()[order])
    assert beams.step == pytest.approx(merged(scan, PAPER).step / 4, rel=1e-3)
    np.testing.assert_array_equal(merged(take_scan(ROOM, sweeps=1), PAPER).ranges, take_scan(ROOM, sweeps=1).ranges[0])


def without(scan, lost):
    """The scan without the returns of the beams `lost`."""
    hit = scan.hit.copy()
    hit[:, lost] = False
    return replace(scan, ranges=np.where(hit, scan.ranges, scan.max_range_m), hit=hit)


@pytest.mark.parametrize("sweeps", [1, 4])
def test_short_runs_are_restored_and_long_ones_are_not(sweeps):
    """Also across the bearing of 180 degrees."""
    scan = take_scan(ROOM, DARK, sweeps=sweeps)
    few, many = [718, 719, 0, 100, 101, 102, 103], list(range(300, 305))
    assert longest_run(DARK.record) == 4
    whole, beams = (merged(one, DARK) for one in (scan, without(scan, few + many)))
    filled = restored(beams, DARK)
    assert filled.hit[few].all()
    assert not filled.hit[many].any()
    np.testing.assert_allclose(filled.ranges[few], whole.ranges[few], atol=0.05)
    kept = np.delete(np.arange(720), few)
    assert np.array_equal(filled.ranges[kept], beams.ranges[kept])


def test_an_opening_between_two_surfaces_is_not_closed():
    faces = np.concatenate([chain((3.0, -1.0), (3.0, 0.0)), chain((6.0, 0.0), (6.0, 3.0))])
    scan = take_scan(faces, DARK, sweeps=1)
    edge = np.flatnonzero(scan.hit[0] & (scan.ranges[0] < 4.0)).max()
    beams = merged(without(scan, [edge]), DARK)
    assert not restored(beams, DARK).hit[edge]


def test_nothing_behind_a_slanting_wall_is_free():
    """A wall 1 m to the left of the robot is seen up to 80 degrees, and hides what is behind it beyond that."""
    faces = chain((30.0, 1.0), (-30.0, 1.0))
    bearings = nominal_bearings(1)
    hit = (bearings > math.radians(10.0)) & (bearings < math.radians(170.0))
    scan = make.scan(cast(faces, bearings), hit=hit)
    beams, _, segments, corners = front_end(scan, SLANTING)
    assert len(segments.line) == 1
    assert len(corners) == 0  # the wall goes on unseen: it has no end there
    assert len(front_end(scan, LMS200)[-1]) > 0
    ended = stopped(beams, segments, SLANTING)
    towards = (bearings[0] > math.radians(3.0)) & (bearings[0] < math.radians(177.0))
    np.testing.assert_allclose(ended.ranges[towards], 1.0 / np.sin(bearings[0][towards]), rtol=0.01)
    assert (ended.ranges[bearings[0] < 0.0] == 30.0).all()
    assert np.array_equal(ended.hit, beams.hit)


@pytest.mark.parametrize(("behind_m", "is_end"), [(6.0, True), (1.0, False), (None, True)])
def test_what_follows_lost_beams_decides_whether_a_wall_ends(behind_m, is_end):
    """A nearer surface that swallows beams hides the wall; a farther one, or nothing at all, shows its end."""
    faces = chain((3.0, -2.0), (3.0, 0.0))
    if behind_m is not None:
        faces = np.concatenate([faces, chain((behind_m, 0.04 * behind_m), (behind_m, 3.0))])  # six beams later
    corners = front_end(make.scan(cast(faces, nominal_bearings(1))), SLANTING)[-1]
    at_end = np.abs(corners.z - [3.0, 0.0]).max(axis=1, initial=0.0) < 0.05
    assert at_end.any() == is_end
