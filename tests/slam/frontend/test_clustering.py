"""Data clustering: the adaptive threshold of III-A.1, its noise term, and runs across the wrap at pi."""

import math

import numpy as np
import pytest

from mecp_env.slam.config import ClusteringConfig
from mecp_env.slam.messages import ClusterKind
from tests.slam import make
from tests.slam.frontend.make import PAPER, PLAIN, SEGMENTS, clusters, merged
from tests.slam.make import MAX_RANGE_M
from tests.slam.scans import EXACT, ROOM, chain, take_scan

PAPER_RULE = ClusteringConfig(threshold="adaptive")


def lone_hits(distances):
    """720 beams of which only some, from beam 300 on, hit something."""
    ranges = np.full(720, MAX_RANGE_M)
    ranges[300 : 300 + len(distances)] = distances
    return make.beams(ranges)


def spans(found):
    """The clusters as sets of beams."""
    return [
        {(p + found.roll) % 720 for p in range(first, last + 1)}
        for first, last in zip(found.first, found.last, strict=True)
    ]


def test_threshold_of_the_paper():
    d = 2.0 * 2.0 * math.sin(math.radians(0.25))  # d = 2 r sin(theta / 2)
    limit = d / math.cos(math.radians(85.0))
    for share, count in ((0.98, 1), (1.02, 2)):
        jump = math.sqrt((share * limit) ** 2 - d**2)  # the second hit is that much farther
        assert len(clusters(lone_hits([2.0, 2.0 + jump]), PAPER_RULE, SEGMENTS, EXACT).first) == count


def test_the_union_of_sweeps_is_clustered_by_the_step_of_one():
    """III-A.1: the step in d is the resolution of the laser, however dense the union is."""
    theta = math.radians(0.5)
    limit = 2.0 * 2.0 * math.sin(theta / 2.0) / math.cos(math.radians(85.0))
    step = theta / 4.0  # of the union of four
    for share, count in ((0.98, 1), (1.02, 2)):
        ranges = np.full(2880, MAX_RANGE_M)
        far = 2.0 + math.sqrt((share * limit) ** 2 - (2.0 * 2.0 * math.sin(step / 2.0)) ** 2)
        ranges[[1200, 1201]] = 2.0, far
        beams = make.beams(ranges)
        assert len(clusters(beams, PAPER_RULE, SEGMENTS, EXACT, sweeps=4).first) == count
        assert len(clusters(beams, PAPER_RULE, SEGMENTS, EXACT).first) == 2


def test_the_threshold_grows_with_range_and_a_fixed_one_does_not():
    fixed = ClusteringConfig(threshold="fixed", fixed_m=0.3)
    for near, config, count in ((1.0, PAPER_RULE, 2), (5.0, PAPER_RULE, 1), (1.0, fixed, 1), (5.0, fixed, 1)):
        assert len(clusters(lone_hits([near, near + 0.25]), config, SEGMENTS, EXACT).first) == count


def test_a_noisy_flat_wall_is_one_cluster_only_with_the_noise_term():
    scans = [take_scan(chain((1.0, -3.0), (1.0, 3.0)), seed=seed, sweeps=1) for seed in range(20)]
    beams = [merged(scan, PAPER) for scan in scans]
    assert np.mean([len(clusters(b, PLAIN, SEGMENTS, PAPER).first) for b in beams]) < 1.5
    cuts = np.mean([len(clusters(b, PAPER_RULE, SEGMENTS, PAPER).first) for b in beams])
    assert cuts > 20  # derivations 2: a fifth of the pairs


def test_a_closed_room_is_one_run_cut_at_its_farthest_corner():
    beams = merged(take_scan(ROOM, EXACT), EXACT)
    found = clusters(beams, PLAIN, SEGMENTS, EXACT)
    assert (found.first.tolist(), found.last.tolist()) == ([0], [719])
    assert beams.bearings[found.roll] == pytest.approx(math.atan2(2.0, 3.0), abs=0.01)


def test_kinds():
    post = chain((2.0, -0.05), (2.0, 0.05))
    wall = chain((2.0, 1.0), (2.0, 3.0))
    beams = merged(take_scan(np.concatenate([post, wall]), EXACT), EXACT)
    kinds = clusters(beams, PLAIN, SEGMENTS, EXACT).kind.tolist()
    assert kinds == [ClusterKind.SMALL, ClusterKind.LINES]


def test_a_laser_with_less_than_a_full_circle_has_a_gap_behind():
    beams = make.beams(np.full(361, 2.0), np.linspace(-math.pi / 2, math.pi / 2, 361))
    found = clusters(beams, PLAIN, SEGMENTS, EXACT)
    assert (found.roll, found.first.tolist(), found.last.tolist()) == (0, [0], [360])


def plain_joined(beams, sigma):
    """Which beams belong together with the next one, by points and the formula of III-A.1 with the noise term."""
    points = beams.ranges[:, None] * np.column_stack([np.cos(beams.bearings), np.sin(beams.bearings)])
    distance = np.hypot(*(np.roll(points, -1, axis=0) - points).T)
    nearer = np.minimum(beams.ranges, np.roll(beams.ranges, -1))
    step = (beams.bearings[-1] - beams.bearings[0]) / 719
    limit = 2.0 * nearer * math.sin(step / 2.0) / math.cos(math.radians(85.0))
    limit = limit + 3.0 * sigma * np.sqrt(1.0 / beams.count + 1.0 / np.roll(beams.count, -1))
    return (distance <= limit) & beams.hit & np.roll(beams.hit, -1)


def test_a_plain_twin_agrees():
    rng = np.random.default_rng(0)
    for seed in range(5):
        posts = [chain(p, p + rng.normal(0.0, 0.5, 2)) for p in rng.uniform(-5.0, 5.0, (25, 2))]
        beams = merged(take_scan(np.concatenate(posts), seed=seed), PAPER)
        found = clusters(beams, PLAIN, SEGMENTS, PAPER)
        together = np.zeros(720, dtype=bool)
        for span in spans(found):
            together[[b for b in span if (b + 1) % 720 in span]] = True
        np.testing.assert_array_equal(together, plain_joined(beams, 0.05))
        assert set().union(*spans(found)) == set(np.flatnonzero(beams.hit).tolist())
