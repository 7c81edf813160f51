"""Corners of constructed scans: kinds, descriptors, doors, and the joint covariance."""

import math

import numpy as np
import pytest

from mecp_env.core.se2 import polar_to_points
from mecp_env.slam.config import CornerConfig, SlamConfig
from mecp_env.slam.frontend.beams import laser_noise
from mecp_env.slam.frontend.door_gaps import widening
from mecp_env.slam.frontend.line_corners import empty_corners, write_end, write_intersection
from mecp_env.slam.messages import CornerKind
from tests.slam import make
from tests.slam.scans import (
    EXACT,
    LMS200,
    PAPER,
    ROOM,
    blank_scan,
    chain,
    corners_of,
    front_end,
    ring,
    take_scan,
    turned,
)

FAR_ROOM = 4.0 * ROOM
DEG = math.pi / 180.0
NARROW = CornerConfig(door_width_m=(0.75, 1.05))
THIN = chain((5.0, -2.0), (5.0, 2.0), (2.12, 2.0), (2.12, 0.45), (2.0, 0.45), (2.0, 2.0), (-2.0, 2.0), (-2.0, -2.0))


def at(points, x, y, within=0.1):
    """Index of the one corner at (x, y)."""
    near = np.flatnonzero(np.hypot(points[:, 0] - x, points[:, 1] - y) < within)
    assert len(near) == 1, f"{len(near)} corners at ({x}, {y})"
    return int(near[0])


@pytest.mark.parametrize(("sensor", "sweeps"), [(PAPER, 1), (LMS200, 4), (EXACT, 4)])
def test_a_room_has_four_concave_intersections_in_order_of_bearing(sensor, sweeps):
    corners, points = corners_of(ROOM, sensor, sweeps=sweeps)
    expected = [(-2.0, -1.5), (3.0, -1.5), (3.0, 2.0), (-2.0, 2.0)]
    np.testing.assert_allclose(points, expected, atol=0.05)
    assert (corners.kind == CornerKind.CROSSING).all()
    assert not corners.convex.any()
    assert corners.sites.all()
    normals = np.array([[0.0, 90.0], [90.0, 180.0], [180.0, -90.0], [-90.0, 0.0]]) * DEG
    np.testing.assert_allclose(np.exp(1j * corners.normals), np.exp(1j * normals), atol=0.05)


def test_a_box_shows_a_convex_intersection_and_line_ends():
    box = turned(ring((-0.3, -0.3), (-0.3, 0.3), (0.3, 0.3), (0.3, -0.3)), 45 * DEG) + np.array([2.0, 0.0])
    half = 0.3 * math.sqrt(2.0)
    for seed in range(10):
        corners, points = corners_of(np.concatenate([box, FAR_ROOM]), PAPER, seed)
        tip = at(points, 2.0 - half, 0.0)
        left, right = at(points, 2.0, half), at(points, 2.0, -half)
        assert corners.convex[[tip, left, right]].all()
        assert corners.kind[tip] == CornerKind.CROSSING
        np.testing.assert_allclose(corners.normals[tip] / DEG, [-135.0, 135.0], atol=15.0)
        assert corners.kind[left] == corners.kind[right] == CornerKind.FREE_END
        assert corners.normals[left, 0] / DEG == pytest.approx(135.0, abs=15.0)  # the face before the corner
        assert np.isnan(corners.normals[left, 1])
        assert np.isnan(corners.normals[right, 0])


def test_an_end_that_something_nearer_hides_is_no_corner():
    wall = chain((3.0, -2.0), (3.0, 2.0))
    screen = chain((1.5, 0.0), (1.5, 3.0))
    for seed in range(10):
        _, points = corners_of(np.concatenate([wall, screen, FAR_ROOM]), PAPER, seed)
        at(points, 3.0, -2.0, within=0.2)
        assert not (np.hypot(points[:, 0] - 3.0, points[:, 1]) < 0.5).any()


@pytest.mark.parametrize(("x", "end"), [(0.8, None), (3.5, None), (2.0, 1.0)])
def test_a_wall_that_leaves_the_range_has_no_end_there_and_one_that_ends_before_has(x, end):
    wall = chain((x, -20.0), (x, 20.0 if end is None else end))
    for seed in range(10):
        points = polar_to_points(front_end(take_scan(wall, PAPER, seed, max_range_m=4.0))[-1].z)
        assert len(points) == (end is not None)
        np.testing.assert_allclose(points, np.array([[x, end or 0.0]])[: len(points)], atol=0.2)


@pytest.mark.parametrize("field_of_view_deg", [180.0, 270.0])
def test_a_wall_that_leaves_the_field_of_view_has_no_end_there(field_of_view_deg):
    for seed in range(5):
        scan = take_scan(ROOM, PAPER, seed)
        seen = abs(scan.bearings[0]) < field_of_view_deg / 2.0 * DEG
        corners = front_end(make.scan(scan.ranges[:, seen], scan.bearings[:, seen]))[-1]
        assert (corners.kind == CornerKind.CROSSING).all()
        assert len(corners) == 2


def test_a_wall_that_goes_on_behind_a_post_has_no_end_there():
    post = ring((1.5, -0.05), (1.5, 0.05), (1.6, 0.05), (1.6, -0.05))
    for seed in range(10):
        corners, _ = corners_of(np.concatenate([post, ROOM]), PAPER, seed)
        assert len(corners) == 4


@pytest.mark.parametrize(
    ("sensor", "sweeps", "end"), [(PAPER, 1, (2.0, 1.0)), (PAPER, 4, (3.0, -0.4)), (LMS200, 4, (2.0, 1.0))]
)
def test_a_line_end_is_where_it_is_and_knows_how_well(sensor, sweeps, end):
    """A wall 0.15 m thick; from the second end its end face is seen, hardly longer than the noise."""
    solid = chain((end[0], -3.0), end, (end[0] + 0.15, end[1]), (end[0] + 0.15, -3.0))
    faces = np.concatenate([solid, FAR_ROOM])
    nis, errors = [], []
    for seed in range(150):
        corners, points = corners_of(faces, sensor, seed, sweeps)
        i = at(points, *end, within=0.3)
        nu = corners.z[i] - make.polar(end)[0]
        nis.append(nu @ np.linalg.solve(corners.R[i], nu))
        errors.append(nu[1])
    assert np.mean(nis) < 2.9
    # without bearing noise the same beams pass the edge every time: half their spacing remains
    half_spacing = 0.0 if sensor.bearing_sigma_deg else 0.25 * DEG / sweeps
    assert abs(np.mean(errors)) < half_spacing + 0.12 * DEG + 3.0 * np.std(errors) / math.sqrt(150)


def thick(x, y, thickness, other):
    """A wall from (x, other) to (x, y), and its end face and back."""
    return chain((x, other), (x, y), (x + thickness, y), (x + thickness, other))


@pytest.mark.parametrize(("beside", "end"), [(0.4, 3.0), (0.8, 4.0), (1.5, 6.0), (2.5, 8.0)])
def test_the_end_of_a_wall_at_a_grazing_angle_is_not_taken_for_nearer(beside, end):
    """The ranges there scatter by decimetres: a beam that is far off the line is on the wall all the same."""
    errors = []
    for seed in range(60):
        faces = turned(np.concatenate([chain((end, beside), (-3.0, beside)), FAR_ROOM]), seed)
        corners, points = corners_of(faces, PAPER, seed)
        far = np.hypot(*(points - turned(np.array([[end, beside]]), seed)).T)
        if far.min(initial=math.inf) < 0.6:
            r, variances = corners.z[far.argmin(), 0], np.diagonal(corners.R[far.argmin()])
            away = math.hypot(*points[far.argmin()]) - math.hypot(end, beside)
            errors.append(away / math.hypot(math.sqrt(variances[0]), r * math.sqrt(variances[1])))
    assert len(errors) > 45
    assert abs(np.mean(errors)) < 3.0 / math.sqrt(len(errors))


@pytest.mark.parametrize(
    ("faces", "point", "least", "off_m"),
    [
        (np.concatenate([thick(1.5, -1.2, 0.12, -4.5), FAR_ROOM]), (1.5, -1.2), 100, 0.02),  # beams of its end face
        (chain((4.0, -3.0), (4.0, 0.0), (3.25, 1.85)), (4.0, 0.0), 100, 0.01),  # oblique, whatever the noise
        # passing the face of a thin wall must not be cheap: the mean error was 7 mm
        (np.concatenate([thick(1.5, 1.0, 0.12, 3.0), chain((5, -6), (5, 6))]), (1.5, 1.0), 96, 0.0055),
    ],
)
def test_ends_and_oblique_corners_are_neither_missed_nor_moved(faces, point, least, off_m):
    seen = [corners_of(faces, seed=seed)[1] - point for seed in range(100)]
    nearest = [offsets[np.hypot(*offsets.T).argmin()] for offsets in seen if len(offsets)]
    errors = np.array([offset for offset in nearest if math.hypot(*offset) < 0.3])
    assert len(errors) >= least
    assert np.abs(errors.mean(axis=0)).max() < off_m


def test_a_face_too_short_for_a_segment_still_makes_a_corner():
    """A room corner whose second wall is hidden but for 0.2 m: concave, with both normals."""
    room = ring((3.0, -3.0), (3.0, 1.0), (-2.0, 1.0), (-2.0, -3.0))
    screen = chain((1.4, 0.50), (1.4, 0.9))  # hides the left wall but for its last 0.2 m, shadow from x = 1.6 to 2.8
    found = 0
    for seed in range(10):
        corners, points = corners_of(np.concatenate([room, screen]), LMS200, seed)
        near = np.flatnonzero(np.hypot(*(points - [3.0, 1.0]).T) < 0.05)
        for i in near:
            assert not corners.convex[i]
            np.testing.assert_allclose(np.exp(1j * corners.normals[i]), [-1.0, -1.0j], atol=0.2)
        found += len(near)
    assert found >= 9


def with_door(width=0.9, thickness=0.12, x=2.0):
    """A wall at x with a door in the middle, a room behind it, one around the robot."""
    half = width / 2
    right = chain((x, -2.0), (x, -half), (x + thickness, -half), (x + thickness, -2.0), (x + 3.0, -2.0))
    left = chain((x + 3.0, 2.0), (x + thickness, 2.0), (x + thickness, half), (x, half), (x, 2.0))
    behind = chain((x + 3.0, -2.0), (x + 3.0, 2.0))
    return np.concatenate([right, behind, left, chain((x, 2.0), (-2.0, 2.0), (-2.0, -2.0), (x, -2.0))])


@pytest.mark.parametrize(("sensor", "angle"), [(PAPER, 0.0), (LMS200, math.pi), (EXACT, -100 * DEG)])
def test_a_door_is_a_pair_of_jambs_also_over_the_wrap(sensor, angle):
    corners, points = corners_of(turned(with_door(), angle), sensor)
    assert len(corners.doorways.jambs) == 1
    right, left = corners.doorways.jambs[0]
    np.testing.assert_allclose(
        points[[right, left]], turned(np.array([[[2.0, -0.45], [2.0, 0.45]]]), angle)[0], atol=0.08
    )
    assert (corners.kind[[right, left]] == CornerKind.JAMB).all()
    assert corners.doorways.width[0] == pytest.approx(0.9, abs=0.1)
    assert corners.doorways.confirmable[0]
    assert corners.convex[[right, left]].all()
    assert not corners.sites[[right, left]].any()
    assert corners.sites.sum() == 4  # the room's own corners


@pytest.mark.parametrize(
    ("width", "config", "doors"),
    [(w, CornerConfig(), n) for w, n in ((0.5, 0), (0.65, 1), (1.2, 1), (1.6, 1), (1.9, 1), (2.1, 0))]
    + [(w, NARROW, n) for w, n in ((0.65, 0), (0.9, 1), (1.4, 0))],
)
def test_a_gap_that_is_no_door_width_is_no_door(width, config, doors):
    found = front_end(take_scan(with_door(width)), config=SlamConfig(corners=config))[-1].doorways
    assert found.width == pytest.approx([width] * doors, abs=0.1)
    assert found.confirmable.all()


def niche(width, depth):
    """A room with a niche of the wall at x = 2."""
    half, back = width / 2, 2.0 + depth
    return ring(
        (2.0, -2.0), (2.0, -half), (back, -half), (back, half), (2.0, half), (2.0, 2.0), (-2.0, 2.0), (-2.0, -2.0)
    )


def block(x, y):
    """The three sides in view of what is between y and 2 m aside, 0.2 to 0.6 m deep."""
    far = math.copysign(2.0, y)
    return chain((x, far), (x, y), (x + 0.4, y), (x + 0.4, far))


NO_DOORS = {
    "niche": (PAPER, niche(0.9, 0.2)),
    "deep niche": (PAPER, niche(0.9, 0.5)),
    "wide niche": (PAPER, niche(1.6, 1.0)),
    "corridor": (PAPER, niche(0.9, 6.0)),
    "corridor aside": (PAPER, niche(1.6, 6.0) - [0.0, 1.0]),  # seen in a plan: rooms were split at its start
    "different depths": (PAPER, np.concatenate([chain((2, -2), (2, -0.45)), chain((2.6, 0.45), (2.6, 2.5)), FAR_ROOM])),
    "aisle": (  # narrow, and seen to go on as wide behind what crosses it
        LMS200,
        np.concatenate([solid for y in (0.45, -0.45) for x in (1.2, 1.8) for solid in [block(x, y)]] + [FAR_ROOM]),
    ),
    "door too wide and too far off to see the floor get wider": (PAPER, with_door(1.6, x=6.0)),
    "beside something deep": (
        LMS200,
        np.concatenate([chain((-2, -2), (2, -2), (2, -0.45), (3.2, -0.45), (3.2, -2), (5, -2)), THIN]),
    ),
}


@pytest.mark.parametrize("name", NO_DOORS)
def test_what_is_no_door(name):
    sensor, faces = NO_DOORS[name]
    for seed in range(5):
        assert len(corners_of(faces, sensor, seed)[0].doorways.jambs) == 0


def beside_a_side_wall(stub):
    """A room whose door of 0.95 m starts `stub` metres from the wall at y = 2, and a larger room behind it."""
    left, right = 2.0 - stub, 1.05 - stub
    near = chain((2.0, left), (2.0, 2.0), (-2.0, 2.0), (-2.0, -2.0), (2.0, -2.0), (2.0, right), (2.12, right))
    return np.concatenate(
        [
            near,
            chain((2.12, right), (2.12, -3.0), (5.0, -3.0), (5.0, 3.0), (2.12, 3.0), (2.12, left)),
            chain((2.12, left), (2.0, left)),
        ]
    )


def test_a_door_beside_a_wall_too_short_to_be_one_is_bounded_by_the_corner_of_the_room():
    """Seen in a home: a bedroom was taken for its corridor, since its door is 0.18 m from the side wall."""
    found = 0
    for seed in range(10):
        corners, points = corners_of(beside_a_side_wall(0.18), LMS200, seed)
        for right, left in corners.doorways.jambs:
            found += 1
            assert points[left] == pytest.approx([2.0, 2.0], abs=0.1)
            assert points[right] == pytest.approx([2.0, 0.87], abs=0.1)
            assert corners.kind[right] == CornerKind.JAMB
            assert corners.kind[left] == CornerKind.CROSSING
            assert corners.sites[left]
            assert not corners.sites[right]
    assert found >= 8
    for seed in range(10):  # a wall of that length has a separate end, which is the jamb
        corners, points = corners_of(beside_a_side_wall(0.8), LMS200, seed)
        assert corners.convex[corners.doorways.jambs].all()


def test_a_door_may_stand_at_an_angle_to_one_of_the_walls_beside_it():
    """Seen in a home: the walls beside the door of a kitchen run off at 45 degrees."""
    end, away, thick = np.array([2.0, 0.6]), np.array([-1.5, 1.5]), np.array([0.12, 0.05])
    wall = chain(end + away, end, end + thick, end + thick + away)
    straight = chain((2.0, -2.0), (2.0, -0.6), (2.12, -0.6), (2.12, -2.0))
    faces = np.concatenate([straight, wall, ring((-3.0, -3.0), (6.0, -3.0), (6.0, 4.0), (-3.0, 4.0))])
    found = sum(len(corners_of(faces, LMS200, seed)[0].doorways.jambs) for seed in range(10))
    assert found >= 8


def test_far_or_slanted_doors_are_jambs_but_no_sighting():
    config = SlamConfig(corners=CornerConfig(door_range_m=3.0, door_incidence_deg=30.0))
    slanted = with_door() - np.array([0.0, 1.7])  # 40 degrees
    for faces, good in ((with_door(), True), (with_door(x=3.5), False), (slanted, False)):
        corners = front_end(take_scan(faces, LMS200), LMS200, config)[-1]
        assert corners.doorways.confirmable.tolist() == [good]


def test_scans_with_next_to_nothing():
    for scan in (blank_scan(), take_scan(chain((2.0, -0.01), (2.0, 0.01)), EXACT), blank_scan(1, 8)):
        corners = front_end(scan)[-1]
        assert len(corners) == 0
        assert corners.cov.shape == (0, 0)
        assert corners.R.shape == (0, 2, 2)
        assert corners.doorways.jambs.shape == (0, 2)


def truth_of(points):
    """z (2n,) of the true corners of ROOM in the order found."""
    return make.polar(np.round(points * 2.0) / 2.0).ravel()


@pytest.mark.parametrize(("sensor", "sweeps"), [(PAPER, 4), (LMS200, 1)])
def test_joint_covariance_of_corners_that_share_walls(sensor, sweeps):
    """All four corners of a room at once: 8 degrees of freedom; taken as independent they would be over-confident."""
    joint, alone, whitened = [], [], []
    for seed in range(300):
        corners, points = corners_of(ROOM, sensor, seed, sweeps)
        nu = corners.z.ravel() - truth_of(points)
        nu[1::2] = (nu[1::2] + math.pi) % (2 * math.pi) - math.pi
        whitened.append(np.linalg.solve(np.linalg.cholesky(corners.cov), nu))
        joint.append(whitened[-1] @ whitened[-1])
        pairs = nu.reshape(4, 2, 1)
        alone.append(np.mean(pairs.transpose(0, 2, 1) @ np.linalg.solve(corners.R, pairs)))
    assert 7.0 < np.mean(joint) < 9.3
    assert 1.6 < np.mean(alone) < 2.4
    spread = np.linalg.eigvalsh(np.cov(np.array(whitened).T))  # one in every direction, if all is right
    assert spread.min() > 0.55
    assert spread.max() < 1.9
    sigma = np.sqrt(np.diag(corners.cov))
    across = (corners.cov / np.outer(sigma, sigma)) * (1.0 - np.kron(np.eye(4), np.ones((2, 2))))
    assert np.abs(across).max() > 0.3  # corners of one wall do depend on each other


def plain_intersection(line):
    """Range and bearing of the point on both lines (4,) of x cos(alpha) + y sin(alpha) = rho."""
    x, y = np.linalg.solve(np.column_stack([np.cos(line[::2]), np.sin(line[::2])]), line[1::2])
    return np.array([math.hypot(x, y), math.atan2(y, x)])


def test_derivatives_of_an_intersection_against_finite_differences():
    base = np.array([[0.3, 2.0], [1.7, 1.5]])
    found = empty_corners(1)[0]
    write_end(found, 0, (0.4, 2.0), make.end_bearing(0.9))  # a line end that was tried in vain leaves nothing
    x, y = write_intersection(found, base, (0, 1))
    assert not found["own"].any()
    np.testing.assert_allclose(found["z"], plain_intersection(base.ravel()))
    np.testing.assert_allclose(found["z"], (math.hypot(x, y), math.atan2(y, x)))
    by_line = make.slopes(plain_intersection, base.ravel()).reshape(2, 2, 2).transpose(1, 0, 2)
    np.testing.assert_allclose(found["jacobian"], by_line, rtol=1e-6, atol=1e-8)


def test_derivatives_of_an_end_against_finite_differences():
    found, line, bearing = empty_corners(1)[0], (0.4, 2.0), 0.9
    write_end(found, 0, line, make.end_bearing(bearing))
    slope = make.slopes(lambda x: x[1] / math.cos(x[2] - x[0]), np.array([*line, bearing]))
    np.testing.assert_allclose(found["jacobian"][0, 0], slope[:2], rtol=1e-6)
    np.testing.assert_allclose(found["own"][0], [slope[2] ** 2 * 1e-4, slope[2] * 1e-4], rtol=1e-6)


def test_constant_sigmas_of_the_paper():
    config = SlamConfig(corners=CornerConfig(covariance="sensor"))
    corners = front_end(take_scan(ROOM), PAPER, config)[-1]
    np.testing.assert_allclose(corners.cov, np.diag([0.05**2, (0.3 * DEG) ** 2] * 4))


@pytest.mark.parametrize(("passing", "sides"), [(0, -1), (3, -1), (4, 2), (7, 2)])
def test_the_floor_gets_wider_where_more_beams_pass_the_line_of_a_jamb_than_stop_there(passing, sides):
    x, y = np.meshgrid(np.linspace(2.77, 2.98, 7), [-0.8, 0.8])  # just deeper behind the gap than any wall
    beyond = np.tile(np.where(np.arange(7) < passing, 2.0, 0.0), 2)
    bearings, ranges = np.arctan2(y, x).ravel(), np.hypot(x, y).ravel() + beyond
    polar = np.stack([ranges, bearings, np.ones(14)])[:, np.argsort(bearings)]
    scan = make.rolled_scan(polar, np.ones(14, dtype=bool), ranges, bearings, DEG, 30.0)
    rules = CornerConfig().record[0], CornerConfig().gaps.record[0], laser_noise(EXACT.record)
    assert widening(scan, (2.0, -0.8), (2.0, 0.8), *rules) == sides


def test_only_what_is_behind_a_door_is_marked_and_no_site():
    door = with_door()[:2]  # the right jamb, and its face
    left = chain((2.12, 0.45), (2.0, 0.45), (2.0, 1.5), (3.2, 1.5), (3.2, 3.0), (-2.0, 3.0), (-2.0, -2.0), (2.0, -2.0))
    before = ring((1.2, -0.2), (1.2, 0.1), (1.36, 0.1), (1.36, -0.2))
    behind = chain((2.12, -0.45), (2.12, -2.0), (5.0, -2.0), (5.0, 1.4), (2.12, 1.4), (2.12, 0.45))
    box = ring((4.0, 0.38), (4.0, 0.75), (4.4, 0.75), (4.4, 0.38))
    for seed in range(3):
        corners, points = corners_of(np.concatenate([door, left, before, behind, box]), LMS200, seed)
        assert len(corners.doorways.jambs) == 1
        assert corners.beyond[at(points, 1.2, 0.1)] == -1
        assert corners.beyond[at(points, 3.2, 3.0)] == -1
        assert corners.beyond[at(points, 4.0, 0.75)] == 0
        assert not corners.sites[at(points, 4.0, 0.75)]
