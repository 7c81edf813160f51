"""The checks of scans, odometry and matches."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mecp_env.slam.association import MatchBuilder
from mecp_env.slam.checks import Fault, MatchError, SensorError, check_match, check_odometry, check_scan, find_fault
from mecp_env.slam.messages import Decision, Reason
from tests.slam import make
from tests.slam.make import MAX_RANGE_M

DAMAGE = (math.nan, math.inf, -math.inf, -1e-9, 0.0, MAX_RANGE_M, 30.1, -math.pi, math.pi, 3.2, -3.2)


def fault_of(ranges, bearings, max_range):
    """The reference implementation of `find_fault`: beam by beam."""
    for sweep, sweep_bearings in zip(ranges.tolist(), bearings.tolist(), strict=True):
        last = -math.inf
        for r, bearing in zip(sweep, sweep_bearings, strict=True):
            if not (math.isfinite(r) and math.isfinite(bearing)):
                return Fault.NOT_FINITE
            if r < 0.0 or r > max_range:
                return Fault.OUT_OF_RANGE
            if not (last < bearing and -math.pi <= bearing <= math.pi):
                return Fault.OUT_OF_ORDER
            last = bearing
    return None


@pytest.mark.parametrize(("max_range", "beams"), [(MAX_RANGE_M, 37), (MAX_RANGE_M, 1), (math.inf, 2), (math.nan, 2)])
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


@pytest.mark.parametrize(
    ("field", "change", "told"),
    [
        ("ranges", np.ndarray.tolist, "scan.ranges: list, an array of float64"),
        ("bearings", lambda a: a[:, 1:], "scan.bearings"),
        ("bearings", lambda a: a[:, ::-1], "scan.bearings"),
        ("hit", np.int64, "scan.hit: an array of int64, one of bool"),
        ("max_range_m", str, r"scan.max_range_m: '30.0', above 0 and at most 1000 m"),
        ("max_range_m", lambda r: 1e3 * r, "scan.max_range_m: 30000.0, above 0"),
    ],
)
def test_a_scan_of_another_type_shape_or_order_is_refused(field, change, told):
    scan = make.scan(np.ones((1, 3)))
    check_scan(scan)
    with pytest.raises(SensorError, match=told):
        check_scan(replace(scan, **{field: change(getattr(scan, field))}))


def unlike(a12, a21, a11=1.0):
    """A covariance in the place of the last."""
    return lambda covs: np.concatenate([covs[:-1], [[[a11, a12], [a21, 1.0]]]])


@pytest.mark.parametrize(
    ("field", "change", "told"),
    [
        ("increments", lambda a: a * np.nan, "every value must be finite"),
        ("increments", lambda a: a[0], r"shape \(2,\) is not"),
        ("increments", lambda a: a + 500.0, r"501, below 500 \(m, rad\) expected"),
        ("bumper", str, "'False', True or False expected"),
        ("cov", lambda a: a[:1], r"shape \(1, 2, 2\), \(2, 2, 2\) expected"),
        ("cov", unlike(0.0, 0.0, -2.0), "variance -2 is below 0"),
        ("cov", unlike(0.5, 0.4), "not symmetric, or not positive"),
        ("cov", unlike(1.1, 1.1), "not symmetric, or not positive"),
    ],
)
def test_unsound_odometry_is_refused(field, change, told):
    for sound in (np.empty((0, 2, 2)), np.zeros((2, 2, 2)), np.tile([[1.0, 0.5], [0.5, 1.0]], (2, 1, 1))):
        reading = make.odometry(np.ones((len(sound), 2)), cov=sound)
        check_odometry(reading)
    with pytest.raises(SensorError, match=rf"odometry\.{field}.*: {told}"):
        check_odometry(replace(reading, **{field: change(getattr(reading, field))}))


def test_what_is_neither_scan_nor_odometry_is_refused():
    for check, kind in ((check_scan, "a Scan"), (check_odometry, "an Odometry")):
        with pytest.raises(SensorError, match=f"NoneType, {kind} expected"):
            check(None)


def with_decision(n, decision, id_):
    """A match of n corners with these values for the last."""
    builder = MatchBuilder(n)
    builder.assign(-1, decision, Reason.UNSEEN, id_)
    return builder.match()


SOUND = with_decision(3, Decision.LANDMARK, 4)


def test_a_sound_match_is_given_back_and_nobody_can_change_it():
    for match in (MatchBuilder(0).match(), SOUND):
        assert check_match(match, len(match.ids), 5) is match
    for column in (SOUND.ids, SOUND.decision, SOUND.reason, SOUND.nis):
        assert not column.flags.writeable


@pytest.mark.parametrize(
    ("match", "told"),
    [
        (None, "match: NoneType, a Match"),
        (MatchBuilder(2).match(), r"match.ids: shape \(2,\), \(3,\) expected"),
        (replace(SOUND, ids=[0, 1, 2]), "match.ids: list, an array of int64"),
        (replace(SOUND, reason=np.zeros(3)), "match.reason: an array of float64, one of int64"),
        (with_decision(3, 4, 0), r"match.decision\[2\]: 4 is not a Decision, 0 to 3"),
        (with_decision(3, Decision.LANDMARK, 5), r"match.ids\[2\]: 5, one of the 5 ids"),
    ],
)
def test_a_match_of_an_unsound_associator_is_refused(match, told):
    """Seen: compiled functions indexed arrays with such a match, and the process died."""
    with pytest.raises(MatchError, match=told):
        check_match(match, 3, 5)
