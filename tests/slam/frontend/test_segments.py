"""Straight segments: where they are cut, the line through them and its covariance."""

import math

import numpy as np
import pytest

from mecp_env.slam.config import SegmentConfig, SensorModel, SlamConfig
from mecp_env.slam.frontend.beams import Beams, laser_noise, roll_beams
from mecp_env.slam.frontend.lines import beam_points, line_cost, split_cluster, without_end_face
from tests.slam.scans import GROWING, LMS200, PAPER, ROOM, cast, chain, front_end, ring, take_scan


def segments_of(faces, sensor=PAPER, seed=0, sweeps=4):
    return front_end(take_scan(faces, sensor, seed, sweeps), sensor)[2]


def noise_of(range_m, bearing):
    """The noise of a laser with these standard deviations (m, rad), its gates as by default."""
    return laser_noise(SensorModel(range_sigma_m=range_m, bearing_sigma_deg=math.degrees(bearing)).record)


def test_what_is_too_short_or_has_too_few_beams_is_no_segment():
    assert len(segments_of(chain((2.0, -0.1), (2.0, 0.1))).line) == 0
    assert len(segments_of(chain((12.0, -0.2), (12.0, 0.2))).line) == 0
    assert len(segments_of(chain((2.0, -0.3), (2.0, 0.3))).line) == 1


@pytest.mark.parametrize(("radius", "distance"), [(0.2, 1.0), (0.2, 6.0), (0.45, 2.0)])
def test_a_round_pillar_is_no_wall(radius, distance):
    angles = np.linspace(0.0, 2.0 * math.pi, 33)[:-1]
    pillar = ring(*(distance + radius * np.cos(angles) + 1j * radius * np.sin(angles)).view(float).reshape(-1, 2))
    found = 0
    for seed in range(20):
        points = segments_of(np.concatenate([pillar, 4.0 * ROOM]), seed=seed).points
        found += (np.hypot(points[..., 0] - distance, points[..., 1]) < radius + 0.2).any()
    assert found <= (0 if radius > 0.3 else 3)  # a thin one at 6 m is met by eight beams


@pytest.mark.parametrize("distance", [2.0, 6.0])
def test_a_narrow_face_is_no_pillar(distance):
    box = ring((distance, -0.25), (distance, 0.25), (distance + 0.4, 0.25), (distance + 0.4, -0.25))
    for seed in range(10):
        middles = segments_of(np.concatenate([box, 4.0 * ROOM]), seed=seed).points.mean(axis=1)
        assert np.hypot(middles[:, 0] - distance, middles[:, 1]).min() < 0.1


@pytest.mark.parametrize(
    ("sensor", "wall"),
    [(PAPER, ((3.0, -0.4), (3.2, 0.4))), (LMS200, ((1.0, 0.5), (4.0, 1.0))), (GROWING, ((6.0, -2.0), (6.0, 3.0)))],
)
def test_covariance_of_the_line(sensor, wall):
    (x0, y0), (x1, y1) = wall
    alpha = math.atan2(x0 - x1, y1 - y0)
    rho = x0 * math.cos(alpha) + y0 * math.sin(alpha)
    alpha, rho = (alpha, rho) if rho > 0 else (math.remainder(alpha + math.pi, 2 * math.pi), -rho)
    nees = []
    for seed in range(200):
        segments = segments_of(chain(*wall), sensor, seed)
        error = segments.line[0] - np.array([alpha, rho])
        nees.append(error @ np.linalg.solve(segments.cov[0], error))
    assert 1.4 < np.mean(nees) < 2.8  # 2 expected; 200 runs have a 95 % band of +-0.28, the rest is for approximations


@pytest.mark.parametrize("share", [0.0, 0.05])
def test_a_wall_is_where_it_is_whatever_the_noise_grows_with(share):
    """By measured ranges, beams that are too short would count for more, and the wall come nearer by 2 share^2."""
    sensor = SensorModel(range_sigma_m=0.01, range_sigma_share=share, bearing_sigma_deg=0.0)
    rho = [segments_of(chain((3.0, -1.5), (3.0, 1.5)), sensor, seed, 1).line[0, 1] for seed in range(200)]
    assert abs(np.mean(rho) / 3.0 - 1.0) < 0.5 * share**2 + 4.0 * np.std(rho) / 3.0 / math.sqrt(200)


def plain_cost(points, cov, first, last):
    """n S / sum of variances for the total-least-squares line, by eigenvectors."""
    p = points[first : last + 1, :2] - points[first : last + 1, :2].mean(axis=0)
    values, vectors = np.linalg.eigh(p.T @ p)
    normal = vectors[:, 0]
    return len(p) * values[0] / sum(normal @ cov[i] @ normal for i in range(first, last + 1))


def random_beams(seed):
    rng = np.random.default_rng(seed)
    bearing = np.linspace(-1.0, 1.0, 80)
    polar = np.column_stack([3.0 + np.cumsum(rng.normal(0.0, 0.05, 80)), bearing, rng.integers(1, 5, 80)])
    noise = noise_of(0.05, 0.005)
    cov = []
    for r, theta, count in polar:
        u, v = np.array([math.cos(theta), math.sin(theta)]), np.array([-math.sin(theta), math.cos(theta)])
        cov.append((noise.range_m**2 * np.outer(u, u) + (r * noise.bearing) ** 2 * np.outer(v, v)) / count)
    points, sums = beam_points(np.ascontiguousarray(polar.T), noise)
    return points, sums, np.array(cov)


def test_chi_square_of_a_line_against_a_plain_twin():
    points, sums, cov = random_beams(0)
    for first, last in ((0, 79), (3, 10), (40, 42), (20, 60)):
        assert line_cost(sums, first, last) == pytest.approx(plain_cost(points.T, cov, first, last))
    assert line_cost(sums, 5, 6) == 0.0


def plain_breaks(points, cov, low, high, sigmas):
    """Ramer-Douglas-Peucker by recursion: the last positions of the lines."""
    chord = points[high, :2] - points[low, :2]
    normal = np.array([-chord[1], chord[0]]) / np.hypot(*chord)
    off = [abs(normal @ (points[i, :2] - points[low, :2])) for i in range(low + 1, high)]
    sigma = [math.sqrt(normal @ cov[i] @ normal) for i in range(low + 1, high)]
    if not off or max(o / s for o, s in zip(off, sigma, strict=True)) <= sigmas:
        return [high]
    split = low + 1 + int(np.argmax(np.array(off) / np.array(sigma)))
    return plain_breaks(points, cov, low, split, sigmas) + plain_breaks(points, cov, split, high, sigmas)


@pytest.mark.parametrize("seed", range(3))
def test_ramer_douglas_peucker_against_a_plain_twin(seed):
    points, _, cov = random_beams(seed)
    breaks = np.empty(81, np.int64)
    size = split_cluster(points, 0, 79, 3.0, breaks)
    assert breaks[: size + 1].tolist() == [-1, *plain_breaks(points.T, cov, 0, 79, 3.0)]


def test_the_papers_segments_are_those_of_ramer_douglas_peucker_alone():
    """Breaks neither move nor go: the ends of the segments are those of the plain twin, whatever chi-square says."""
    paper, differ = SlamConfig.paper(), 0
    plain = SlamConfig(segments=paper.segments)
    for seed in range(5):
        beams, clusters, segments, _ = front_end(take_scan(ROOM, seed=seed), PAPER, plain)
        polar = roll_beams(Beams.of(beams), clusters.roll)
        points, _ = beam_points(polar, laser_noise(PAPER.record))
        breaks, expected = np.empty(points.shape[1] + 2, np.int64), set()
        for first, last in zip(clusters.first, clusters.last, strict=True):
            size = split_cluster(points, first, last, PAPER.noise_sigmas, breaks)
            expected |= {(breaks[k] + 1, breaks[k + 1]) for k in range(size)}
        found = set(zip(segments.first.tolist(), segments.last.tolist(), strict=True))
        assert found <= expected
        moved = front_end(take_scan(ROOM, seed=seed), PAPER)[2]
        differ += not set(zip(moved.first.tolist(), moved.last.tolist(), strict=True)) <= expected
    assert differ == 5


@pytest.mark.parametrize(
    ("faces", "wall"),
    [
        (chain((0.3, 3.0), (0.3, 1.0), (0.36, 1.0)), (6, 27)),
        (chain((0.3, -3.0), (0.3, -1.0), (0.36, -1.0)), (0, 21)),
        (chain((1.0, -1.0), (1.0, 1.0), (0.9, 1.0)), (0, 186)),  # in front of the wall no end face is seen
    ],
)
def test_an_end_face_is_taken_off_a_wall_at_its_near_end(faces, wall):
    bearings = np.radians(np.arange(-179.0, 180.0, 0.5))
    ranges = cast(faces, bearings)
    seen = np.isfinite(ranges)
    points, sums = beam_points(np.stack([ranges[seen], bearings[seen], np.ones(seen.sum())]), noise_of(0.02, 0.0))
    assert without_end_face(points, sums, 0, seen.sum() - 1, SegmentConfig().record[0], noise_of(0.02, 0.0)) == wall
