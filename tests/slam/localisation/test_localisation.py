"""Noticing a wrong pose and finding it again: the map's word on a scan, the search, and whole drives."""

import copy
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.association import ignored
from mecp_env.slam.config import AssociationConfig, FilterConfig, LocalisationConfig
from mecp_env.slam.filters import make_filter
from mecp_env.slam.localisation import Evidence, PoseGuard, agreement, count_ends
from mecp_env.slam.localisation.relocalisation import LandmarkIndex, clear_winner, count_distinct, fit, moved
from mecp_env.slam.messages import NO_ID, Cell, Decision, Reason
from mecp_env.slam.pipeline import SlamPipeline
from tests.slam import make
from tests.slam.drives import fed
from tests.slam.make import evidence

CONFIG, NAN = LocalisationConfig(), math.nan
REACH_M, PAIRING = 8.0, AssociationConfig()
AGREES, CONTRADICTS = evidence(1.0, 1.0), evidence(0.3, 0.1)


def agreeing(beams, T_map_robot, grid):
    return agreement(beams, T_map_robot, grid, REACH_M, CONFIG.explained_share)


def filter_with(landmarks):
    """A filter that knows its pose, and so many landmarks."""
    z, R = np.column_stack([np.full(landmarks, 2.0), 0.3 * np.arange(landmarks)]), 1e-4 * np.eye(2 * landmarks)
    estimate = make_filter(FilterConfig())
    estimate.augment(z, R, np.arange(landmarks))
    return estimate


def off(a, b):
    return math.dist(a[:2], b[:2]), abs(wrap_angle(a[2] - b[2]))


def plain_count(beams, pose, grid, reach_m):
    """The counts of `count_ends`, by maps of cells near walls and amid floor."""
    walls = ndimage.binary_dilation(np.isin(grid.label, [Cell.OCCUPIED, Cell.DOOR]), np.ones((3, 3)))
    floor = ndimage.binary_erosion(grid.label == Cell.FREE, np.ones((5, 5))) & ~walls
    r, b = (of[::4][(beams.hit & (beams.ranges <= reach_m))[::4]] for of in (beams.ranges, beams.bearings))
    ends = pose[:2] + r[:, None] * np.stack([np.cos(pose[2] + b), np.sin(pose[2] + b)], axis=1)
    cells = np.floor((ends - grid.origin) / grid.resolution_m).astype(int)[:, ::-1]
    row, column = cells[((cells >= 2) & (cells < np.array(grid.label.shape) - 2)).all(axis=1)].T
    return walls[row, column].sum(), floor[row, column].sum(), len(r)


def test_ends_of_beams_are_counted_as_the_plain_twin_does():
    rng = np.random.default_rng(0)
    for _ in range(20):
        label = rng.choice([0, 1, 1, 1, 1, 1, 1, 1, 1, 2, 3], (60, 70), p=None).astype(np.uint8)
        grid = make.grid(label, origin=(-3.0, -2.5))
        beams = make.beams(rng.uniform(0.2, 9.0, 400), np.sort(rng.uniform(-3.1, 3.1, 400)), rng.random(400) < 0.9)
        pose = rng.uniform(-1.0, 1.0, 3)
        floor = grid.label, grid.origin, grid.resolution_m
        found = count_ends(beams.ranges, beams.bearings, beams.hit, pose, floor, REACH_M)
        assert found == plain_count(beams, pose, grid, REACH_M)


def test_the_map_agrees_at_the_right_pose_and_contradicts_one_a_metre_off(mapped):
    _, output, drive = mapped
    T_map_robot = drive.T_map_robot[-1]
    right = agreeing(output.beams, T_map_robot, output.grid)
    wrong = agreeing(output.beams, T_map_robot + np.array([0.7, 0.7, 0.3]), output.grid)
    assert right.share > 0.95
    assert right.explained > 0.8
    assert not right.contradicts
    assert wrong.contradicts
    empty, far = make.grid(np.zeros((0, 0))), np.array([500.0, 0.0, 0.0])
    for said in (agreeing(output.beams, np.zeros(3), empty), agreeing(output.beams, far, output.grid)):
        assert math.isnan(said.share)  # without a map nothing is said
        assert not said.contradicts


def test_fitted_poses_are_those_that_moved_the_points():
    rng = np.random.default_rng(1)
    points = rng.normal(size=7) + 1j * rng.normal(size=7)
    poses = np.column_stack((rng.uniform(-9, 9, (50, 2)), rng.uniform(-3.1, 3.1, 50)))
    there = moved(poses, points)
    used = rng.random(there.shape) < 0.7
    used[:, :2] = True
    there[~used] += 5.0
    np.testing.assert_allclose(fit(np.broadcast_to(points, there.shape), there, used), poses, atol=1e-9)
    assert count_distinct(np.array([[3, 3, -1, 0], [-1, -1, -1, -1], [1, 2, 3, 4]])).tolist() == [2, 0, 4]


def test_one_scan_is_located_anywhere_in_the_map(mapped):
    pipeline, output, drive = mapped
    view = pipeline.map.view(output.belief, output.graph, np.empty(0, np.int64), output.step)
    index = LandmarkIndex(view, CONFIG, REACH_M, PAIRING)
    hits = 0
    for k, features in enumerate(fed(SlamPipeline(), drive)):
        if k % 10 == 0:
            found = index.locate(features.corners, features.polygons)
            assert all(len(one.corners) == len(set(one.ids.tolist())) for one in found)
            hits += bool(found) and off(found[0].T_map_robot, drive.T_map_robot[k]) < (0.2, 0.1)
    assert hits >= 0.8 * (len(drive.scans) // 10)


SIX, THREE, FAR = [1, 2, 3, 4, 5, 6], [11, 12, 13], (5.0, 0.0, 0.0)
CLEAR, FEW = make.hypothesis(SIX), make.hypothesis(THREE, FAR, share=0.9)
SURER, RIVAL = CLEAR._replace(share=0.9), make.hypothesis(THREE, FAR, explained=0.7)
TWIN = make.hypothesis(SIX[::-1], (5.0, 0.0, 3.1), recognised=0.6)  # of as many corners
NEAR = make.hypothesis(THREE, (0.5, 0.0, 0.0), near=True)
FOUR = make.hypothesis([1, 2, 3, 4], (7.6, 0.0, 0.0), explained=0.74)
WINNERS = {  # poses that a search finds, and which of them wins
    "nothing": ([], None),
    "one": ([CLEAR], 0),
    "one of too few corners": ([make.hypothesis(THREE, explained=1.0)], None),
    "one that explains too few beams": ([CLEAR._replace(explained=0.5)], None),
    "another of one corner fewer": ([CLEAR, make.hypothesis([*THREE, 14, 15], FAR, share=0.9)], None),
    "another of few corners": ([CLEAR, FEW], 0),
    "another whose beams agree better": ([SURER, RIVAL], None),
    "another that the map contradicts": ([SURER, RIVAL._replace(share=0.5)], 0),
    "a twin that the corners fit worse": ([CLEAR, TWIN], 0),
    "a twin that they fit as well": ([CLEAR, TWIN._replace(recognised=0.7)], None),
    "a twin that more beams fit": ([SURER, TWIN], None),
    "a near one": ([CLEAR, NEAR], 1),
    "a near one in equal bays": ([CLEAR, NEAR._replace(explained=0.87)], 1),
    "a near one that explains less": ([CLEAR, NEAR._replace(explained=0.85)], 0),
    "a near one in a room of nearly the same size": ([CLEAR, NEAR._replace(at=replace(NEAR.at, off=2.0))], 0),
    "a far one that the corners fit": ([FOUR], 0),
    # another room of about the same size explains the walls: 4 of 10 corners were enough after a slip
    "a far one that they do not fit": ([FOUR._replace(recognised=0.4)], None),
    "a near one that they do not fit": ([FOUR._replace(recognised=0.4, near=True)], 0),
}


@pytest.mark.parametrize("name", WINNERS)
def test_a_pose_wins_only_where_no_other_explains_as_much(name: str):
    poses, winner = WINNERS[name]
    assert clear_winner(poses, CONFIG) is (None if winner is None else poses[winner])


@pytest.mark.parametrize(("differs_m", "found"), [(0.0, False), (0.005, False), (0.1, True)])
def test_a_room_that_looks_the_same_turned_around_is_told_by_centimetres(differs_m: float, found: bool):
    half = np.array([[2.0, 1.0], [1.0, 2.5], [-1.5, 2.0], [0.5, 3.2]])
    p_map = np.concatenate([half, -half + differs_m * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])])
    normals = np.repeat([[0.0, 1.5], [math.pi, 1.5 - math.pi]], 4, axis=0)
    corners = make.corners(points=p_map, cov=1e-5, normals=normals)
    view = make.view(
        make.belief(p_map=p_map, covs=1e-5), make.features(8, convex=1, normals=normals), corners, make.graph()
    )
    poses = LandmarkIndex(view, CONFIG, REACH_M, PAIRING).locate(corners, ())
    assert {round(abs(at.T_map_robot[2]), 1) for at in poses} == {0.0, 3.1}
    assert poses[0].misfit == pytest.approx(0.0, abs=1e-6)
    found_there = [make.hypothesis([], recognised=1.0 - at.misfit / 8)._replace(at=at) for at in poses]
    best = clear_winner(found_there, CONFIG)
    assert (best is not None) == found
    assert best is None or np.allclose(best.at.T_map_robot, 0.0, atol=1e-6)


def test_what_a_pose_leaves_unexplained_is_counted_in_corners():
    p_map, cov, covs = np.array([[3.0, 1.0], [1.0, 4.0], [-2.0, 3.0]]), 4e-4, 1e-4
    seen = p_map + np.array([[0.02, 0.0], [0.0, 0.03], [0.0, 0.14]])
    corners = make.corners(points=[*seen, [-3.0, -3.0]], cov=cov)
    view = make.view(make.belief(p_map=p_map, covs=covs), make.features(3, convex=1), corners, make.graph())
    at = LandmarkIndex(view, CONFIG, REACH_M, PAIRING).look_at(corners, np.zeros(3))
    x, y, t = at.T_map_robot
    turn, misfit = np.array([[math.cos(t), -math.sin(t)], [math.sin(t), math.cos(t)]]), 1.0  # no landmark near the last
    for corner, row in zip(at.corners, at.ids, strict=True):
        r, b = corners.z[corner]
        J = np.array([[math.cos(b), -r * math.sin(b)], [math.sin(b), r * math.cos(b)]])
        S = turn @ J @ (cov * np.eye(2)) @ J.T @ turn.T + covs * np.eye(2)
        nu = np.array([x, y]) + turn @ (r * np.array([math.cos(b), math.sin(b)])) - p_map[row]
        nis = nu @ np.linalg.inv(S) @ nu  # noise alone: 2 on the average
        misfit += min(max(nis - 2.0, 0.0) / PAIRING.rival_gap, 1.0)
    assert (at.misfit, at.off) == pytest.approx((misfit, misfit - 1.0))


def test_beams_and_corners_speak_for_a_pose():
    enough = [(1.0, 1.0), (0.3, 0.9), (0.7, 0.2), (0.9, 0.0), (NAN, 0.2), (NAN, NAN)]  # beams and corners that agree
    few = [(0.3, 0.2), (0.7, 0.0), (NAN, 0.0), (0.3, NAN)]  # or what looks new has nothing in common with the map
    assert [evidence(*shares).is_enough for shares in enough + few] == [True] * len(enough) + [False] * len(few)
    assert not evidence(0.3, 0.9, sharp=False).is_enough  # a wide prediction may have paired them wrongly
    assert [evidence(0.3, 0.7, sharp=False, many=many).is_enough for many in (True, False)] == [True, False]


def test_a_least_share_of_zero_turns_the_guard_off():
    off = evidence(NAN, 0.0, sharp=False, explained=0.0, least=0.0)
    assert off.is_enough
    assert off.fits
    assert evidence(0.3, NAN, sharp=False, least=0.0).fits  # and nothing is tried again


@pytest.fixture
def guard() -> PoseGuard:
    return PoseGuard(CONFIG, REACH_M, PAIRING)


def test_a_pose_that_was_found_does_not_remember_how_it_was_lost(guard):
    guard.lose(anywhere=True)
    assert np.isfinite(guard.slack()).all()
    guard.trust()
    assert np.isfinite(guard.slack()).all()


@pytest.mark.parametrize(
    ("landmarks", "anywhere", "after"),
    [(3, False, 8), (4, False, 40), (7, False, 40), (8, False, math.inf), (3, True, math.inf)],
)
def test_a_search_ends_where_the_map_has_too_few_landmarks_for_it(guard, landmarks: int, anywhere: bool, after: float):
    estimate = filter_with(landmarks)
    guard.lose(anywhere)
    ends = math.isfinite(after)
    resumed = [guard.resumes(estimate, landmarks) for _ in range(int(after) if ends else 200)]
    assert resumed == [False] * (len(resumed) - 1) + [ends]
    assert guard.localised == ends
    sigma_m = math.sqrt(estimate.belief().pose_cov[0, 0])
    assert sigma_m == pytest.approx(CONFIG.inlier_m if ends else 0.0, abs=2e-3)  # odometry may have failed by so much


@pytest.mark.parametrize(("unsure_from", "diverged"), [(NO_ID, True), (7, False)])
def test_a_pose_that_is_known_to_be_unsure_has_not_diverged(unsure_from: int, diverged: bool):
    """Seen: a robot lost for five metres of corridor mapped on, loosened by as much, and this was a divergence."""
    pipeline = SlamPipeline()
    pipeline.guard.unsure_from = unsure_from
    pipeline.filter.loosen(np.diag([36.0, 36.0, 0.1]))
    assert pipeline.watched().pose_cov[0, 0] > 36.0
    assert pipeline.divergence.found == diverged


def test_after_some_way_on_unmapped_floor_mapping_goes_on_and_is_marked_until_the_loop_is_closed(guard):
    estimate = filter_with(9)
    guard.lose()
    metre = make.odometry([1.0, 0.0], (0.01, 0.01))

    def drive(share: float) -> bool:
        guard.follow(metre)
        guard.trusts(evidence(share, 0.0))
        return guard.resumes(estimate, 20)

    while guard.unmapped + 1.0 <= REACH_M:
        assert not drive(NAN)
    assert not drive(0.1)  # beams that end in mapped space contradict: the way begins anew
    assert guard.unmapped == 0.0
    before = estimate.belief().pose_cov
    while not drive(NAN):
        assert not guard.localised
    assert guard.localised
    assert guard.resumed == 1
    np.testing.assert_array_equal(estimate.belief().pose_cov, before)  # with the covariance of odometry
    known = np.array([3, 4, 5, 21, 22])
    match = ignored(6).assign(np.arange(5), known, int(Decision.LANDMARK), int(Reason.JOINT))
    assert guard.settle(match) == 20
    track = match.assign(np.array([5]), np.array([6]), int(Decision.PROVISIONAL), int(Reason.UNSEEN))
    assert guard.settle(track) == 20  # an earlier track is no place that was recognised
    fourth = match.assign(np.array([5]), np.array([6]), int(Decision.LANDMARK), int(Reason.JOINT))
    assert guard.settle(fourth) == NO_ID


@pytest.mark.parametrize(("share", "turned", "loosened"), [(0.65, 0.2, True), (0.65, 0.01, False), (0.0, 0.2, False)])
def test_pairs_that_no_odometry_explains_loosen_the_prediction(share: float, turned: float, loosened: bool):
    config = CONFIG.model_copy(update={"explained_share": share})
    guard, estimate = PoseGuard(config, REACH_M, PAIRING), make_filter(FilterConfig())
    z, R = np.array([[2.0, 0.3], [2.5, -0.8], [1.5, 2.0]]), np.diag(np.tile([0.01**2, 0.004**2], 3))
    estimate.augment(z, R, np.arange(3))
    estimate.loosen(np.diag([0.003, 0.003, 0.002]) ** 2)
    plain, seen = estimate.copy(), z - [0.0, turned]
    guard.update(estimate, seen, R, np.arange(3), True)
    plain.update(seen, R, np.arange(3), iterate=True)
    heading = estimate.belief().T_map_robot[2]
    assert abs(heading - turned) < 0.01 if loosened else heading == plain.belief().T_map_robot[2]
    assert abs(plain.belief().T_map_robot[2] - turned) > 0.015 or turned < 0.1


def trusted(guard: PoseGuard, *said: Evidence) -> list[bool]:
    """Whether the pose is trusted after each scan."""
    return [guard.trusts(one) for one in said]


def test_two_scans_in_a_row_that_contradict_the_map_end_the_trust(guard, mapped):
    belief = mapped[1].belief
    assert guard.confidence(belief) > 0.99
    assert trusted(guard, AGREES, CONTRADICTS, AGREES, CONTRADICTS) == [True, False, True, False]
    assert guard.localised
    assert trusted(guard, CONTRADICTS) == [False]
    assert not guard.localised
    assert guard.confidence(belief) < 0.01
    assert trusted(guard, AGREES) == [False]  # only a search ends it


@pytest.mark.parametrize(("vouched", "after"), [(20, 1), (0, 4)])
def test_a_track_that_is_unbroken_since_the_pose_was_sure_is_not_given_up(guard, vouched: int, after: int):
    """A map that is bent or a wall that was moved contradicts it; a track that began elsewhere is a carried robot's."""
    broken = CONTRADICTS._replace(tracked=True)
    assert all(trusted(guard, *[broken._replace(vouched=True)] * vouched))
    assert not any(trusted(guard, *[broken] * (after - 1)))
    assert guard.localised
    assert not guard.trusts(broken)
    assert not guard.localised


def test_a_doubt_stays_until_something_speaks_for_the_pose(guard):
    """Of two known corners beyond the mapped floor it is unknown where they were seen from."""
    silent = evidence(NAN, NAN)
    assert trusted(guard, silent, CONTRADICTS, *[silent] * 10) == [True] + [False] * 11
    assert guard.localised
    some = evidence(NAN, 0.2)  # a few recognised corners beyond the mapped floor say something
    assert trusted(guard, evidence(NAN, 1.0), silent, CONTRADICTS, some) == [True, True, False, True]


def test_confidence_falls_with_the_covariance_of_the_position(guard, mapped):
    belief = mapped[1].belief
    before = guard.confidence(belief)
    assert guard.trusts(evidence(NAN, 0.2))  # nothing is mapped there
    assert guard.confidence(belief) == before
    sure, wide = (guard.confidence(replace(belief, pose_cov=np.eye(3) * sigma**2)) for sigma in (0.05, 0.5))
    assert wide == pytest.approx((1.0 - math.exp(-0.5)) * sure, rel=1e-6)


@pytest.mark.parametrize(
    ("share", "sudden", "off_m", "same"),
    [(1.0, False, 0.05, True), (1.0, False, 0.2, False), (1.0, True, 0.05, False), (0.7, False, 0.05, False)],
)
def test_a_corner_more_at_the_same_place_is_no_sign_of_failed_odometry(guard, share, sudden, off_m, same) -> None:
    one, other = make.belief((3.0, 2.0, 3.1)), make.belief((3.0, 2.0 + off_m, -3.1))
    assert guard.is_same(evidence(share, 0.5, sudden=sudden), one, other) == same
    assert not guard.is_same(evidence(1.0, 0.5), one, make.belief((3.0, 2.0, 2.9)))


@pytest.mark.parametrize(
    ("turned", "sigma", "clear"),
    [(0.04, 0.015, True), (0.04, 0.0, False), (0.08, 0.015, False), (0.08, 0.11, False)],
)
def test_a_pose_that_a_sharp_prediction_allows_needs_no_search(guard, mapped, turned, sigma, clear) -> None:
    """Of an empty scan, a search finds nothing."""
    pipeline, output, _ = mapped
    pose, graph, nothing = output.belief.T_map_robot, output.graph, make.corners()
    predicted = replace(output.belief, T_map_robot=pose + np.array([0.0, 0.0, turned]), pose_cov=np.eye(3) * sigma**2)
    view = pipeline.map.view(predicted, graph, np.empty(0, np.int64), output.step)
    assert guard.is_clear(nothing, (), view, output.beams, output.grid, output.belief) == clear


def way_back(drive, error):
    """Odometry and scans of the last 20 steps in reverse order, the first reading with an `error` (m, rad)."""
    back = list(range(len(drive.scans) - 1, len(drive.scans) - 21, -1))
    for n, k in enumerate(back):
        taken = drive.odometry[k if n == 0 else k + 1]
        increments = np.ascontiguousarray(-taken.increments[::-1]) * (n > 0)
        increments[0] += error if n == 0 else 0.0
        yield replace(taken, increments=increments), drive.scans[k], drive.T_map_robot[k]


@pytest.mark.parametrize("error", [(0.1, math.radians(7.0)), (-1.0, math.radians(20.0))])  # with the first, beams fit
def test_a_wrong_odometry_reading_is_undone_without_a_trace_in_the_map(mapped, error):
    before, _, drive = mapped
    pipeline = copy.deepcopy(before)
    landmarks, features = pipeline.filter.belief().ids, len(pipeline.map.features)
    errors = []
    for odometry, scan, truth in way_back(drive, error):
        output = pipeline.step(odometry, scan)
        errors.append(off(output.belief.T_map_robot, truth)[0])
        assert output.confidence < 0.5 or errors[-1] < 0.5
    assert output.localised
    assert max(errors[10:]) < 0.1
    assert np.isin(landmarks, pipeline.filter.ids).all()
    assert len(pipeline.map.features) - features < 10


def test_a_robot_carried_to_the_other_room_is_noticed_and_found(mapped):
    before, _, drive = mapped
    pipeline = copy.deepcopy(before)
    step = next(k for k, pose in enumerate(drive.T_world_robot) if pose[0] > 6.5)
    trace = [pipeline.step(drive.odometry[k], drive.scans[k]) for k in range(step, step + 15)]
    assert min(output.confidence for output in trace[:10]) < 0.5
    assert not all(output.localised for output in trace)
    assert trace[-1].localised
    assert off(trace[-1].belief.T_map_robot, drive.T_map_robot[step + 14]) < (0.1, 0.05)
    last = max(k for k, output in enumerate(trace) if not output.localised)
    assert trace[last + 1].graph.current != trace[0].graph.current  # in the room that it is found in
    searching = [output for output in trace if not output.localised]
    assert all((output.match.decision != 0).all() for output in searching)
    assert len({output.grid.version for output in searching}) == 1


def test_another_attempt_must_explain_more():
    fewer_beams, fewer_corners, weak = ((0.9, 0.9), (1.0, 0.1)), ((1.0, 0.1), (0.7, 0.9)), ((0.8, 0.9), (0.3, 0.1))
    for one, other in (fewer_beams, fewer_corners, weak):
        assert not evidence(*one, sharp=False).beats(evidence(*other))
        assert not evidence(*one).doubted().is_enough
    for other in ((0.7, 0.1), (1.0, 0.1), (NAN, 0.0)):
        assert evidence(1.0, 0.9, sharp=False).beats(evidence(*other))
    here = evidence(0.93, 0.25, explained=0.89)  # the log fr079: four walls 0.17 m off, which more corners fit
    assert not evidence(0.95, 1.0, sharp=False, explained=0.68).beats(here)  # but a fifth of the beams leave the map
    assert evidence(0.95, 1.0, sharp=False, explained=0.9).beats(here)


def test_corners_that_are_missing_where_all_is_mapped_or_all_gone_in_one_step_do_not_fit():
    assert all(evidence(*shares).fits for shares in ((1.0, 1.0), (1.0, NAN), (NAN, 0.2), (NAN, NAN)))
    assert not any(evidence(*shares).fits for shares in ((1.0, 0.1), (NAN, 0.0)))
    assert evidence(1.0, 0.1, explained=0.5).fits  # at a frontier
    assert evidence(0.9, 0.0, explained=0.5).fits  # a new room, as the scan before showed little of the map, too
    assert not evidence(0.9, 0.0, explained=0.5, sudden=True).fits
    assert evidence(0.9, 0.7, sudden=True).fits  # most are recognised all the same
