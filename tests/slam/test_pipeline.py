"""The whole estimator, on scripted drives through two rooms and around a ring."""

import inspect
from dataclasses import replace

import numpy as np
import pytest

from mecp_env.slam.association.mecp import MecpAssociator
from mecp_env.slam.checks import SensorError
from mecp_env.slam.config import AssociationConfig, FilterConfig, SensorModel, SlamConfig
from mecp_env.slam.landmark_map import LandmarkMap
from mecp_env.slam.localisation import Evidence, PoseGuard
from mecp_env.slam.messages import CornerKind, Decision, FeatureState, Reason
from mecp_env.slam.panorama import RecentScans
from mecp_env.slam.pipeline import SlamPipeline
from tests.slam import make
from tests.slam.drives import fed, majority_identity, scripted_drive, share_right

NOISE: dict[str, dict[str, float]] = {
    "paper": {},
    "1 cm": {"range_sigma_m": 0.01, "bearing_sigma_deg": 0.0},
    "none": {"range_sigma_m": 0.0, "bearing_sigma_deg": 0.0},
}


@pytest.fixture(scope="module")
def steps(drive):
    return list(drive.run(SlamConfig()))


@pytest.mark.parametrize("noise", NOISE)
def test_every_noise_gives_a_right_map(noise):
    run = list(scripted_drive(**NOISE[noise]).run(SlamConfig(sensor=SensorModel(**NOISE[noise]))))
    _, output, _, _ = run[-1]
    precision, pairs = share_right(run)
    assert precision > 0.99
    assert pairs > 300
    assert np.sqrt(np.mean([e[0] ** 2 + e[1] ** 2 for *_, e in run])) < 0.05
    assert not output.diverged
    assert len(output.graph.rooms) == 2
    assert [door.rooms for door in output.graph.doors] == [(0, 1)]


def test_each_landmark_is_a_corner_of_its_own(steps):
    """Both rooms have corners within 0.15 m of each other across the wall: no two landmarks share a true corner."""
    identity = majority_identity(steps)
    corners = [identity[landmark] for landmark in steps[-1][1].belief.ids.tolist()]
    assert min(corners) >= 0
    assert len(set(corners)) == len(corners)


def test_polygons_of_different_rooms_share_no_vertex(steps):
    """Fig. 6, after every scan."""
    for _, output, _, _ in steps:
        owner = {}
        for polygon in output.map_polygons:
            room = output.graph.resolve(polygon.room)
            for vertex in polygon.ids.tolist():
                assert owner.setdefault(vertex, room) == room


def test_most_scans_recognise_a_polygon_once_the_room_is_known(steps):
    assert np.mean([output.match.known >= 0 for _, output, _, _ in steps[5:]]) > 0.6


def test_the_robots_room_is_the_true_one_away_from_the_door(drive, steps):
    for pose, (_, output, _, _) in zip(drive.T_world_robot, steps, strict=True):
        if abs(pose[0] - 5.0) > 0.7:
            assert output.graph.current == (0 if pose[0] < 5.0 else 1)


def test_landmarks_lie_in_the_room_of_their_corner(drive, steps):
    identity = majority_identity(steps)
    pipeline = steps[-1][0]
    for landmark in steps[-1][1].belief.ids.tolist():
        if pipeline.map.features.rows["kind"][landmark] != int(CornerKind.JAMB):
            west = drive.outline.corners.p_world[identity[landmark], 0] < 5.0
            assert pipeline.rooms.resolve(int(pipeline.map.features.rows["room"][landmark])) == (0 if west else 1)


def test_visible_landmarks_are_the_vertices_of_the_polygons_around_a_point(steps):
    pipeline, output, _, _ = steps[-1]
    here = pipeline.visible_landmarks(output.belief.T_map_robot[:2])
    assert len(here) >= 4
    assert (pipeline.map.features.rows["state"][here] == int(FeatureState.LANDMARK)).all()
    assert len(pipeline.visible_landmarks(np.array([100.0, 100.0]))) == 0


def test_every_decision_has_its_reason(steps):
    allowed = {
        Decision.LANDMARK: {Reason.POLYGON, Reason.JOINT},
        Decision.PROVISIONAL: {Reason.TRACK},
        Decision.NEW: {Reason.UNSEEN},
        Decision.IGNORED: {Reason.AMBIGUOUS},
    }
    for _, output, _, _ in steps:
        for decision, reason in zip(output.match.decision, output.match.reason, strict=True):
            assert Reason(reason) in allowed[Decision(decision)]


def test_without_polygons_rooms_and_descriptor_the_default_associator_recognises_no_polygon(drive):
    switches = {"use_polygons": False, "use_rooms": False, "use_descriptor": False}
    run = list(drive.run(SlamConfig(association=AssociationConfig(**switches))))
    assert not any(output.match.known >= 0 for _, output, _, _ in run)
    assert len(run[-1][1].belief.ids) > 8


def neglected(far, errors):
    """(n,2) m, in range and across: by how much a corner at (far, 0) is elsewhere than the derivatives by pose errors
    (n,3) along, across and in heading say."""
    along, across, turn = errors.T
    moved = np.hypot(far - along, across) - (far - along), far * (np.arctan2(-across, far - along) + across / far)
    return np.stack([moved[0] + far * (1.0 - np.cos(turn)), moved[1]], axis=1)


@pytest.mark.parametrize("sigmas", [(0.05, 1e-9), (1e-9, 0.03)])
def test_what_one_linearisation_neglects_is_added_to_every_corner(steps, sigmas):
    corners, spread = steps[-1][1].corners, np.diag([sigmas[0], sigmas[0], sigmas[1]])
    wider, errors = corners.with_linearisation(spread**2), np.random.default_rng(0).normal(size=(4000, 3)) @ spread
    added = np.sqrt((wider.cov - corners.cov).diagonal()).reshape(-1, 2)
    assert len(corners) > 3
    for (far, _), (in_range, in_bearing) in zip(corners.z, added, strict=True):
        largest = np.sqrt((neglected(far, errors) ** 2).mean(axis=0)).max()
        assert in_bearing * far == pytest.approx(in_range)
        assert 0.9 * largest < in_range < 1.3 * largest


@pytest.mark.parametrize(("sigma_m", "added"), [(0.05, True), (0.5, False)])
def test_a_rough_pose_adds_nothing_since_its_update_is_iterated(drive, sigma_m, added):
    covs = []
    for second_order in (True, False):
        pipeline = SlamPipeline(SlamConfig(filter=FilterConfig(second_order=second_order)))
        pipeline.start(drive.scans[0])
        pipeline.filter.loosen(np.diag([sigma_m**2, sigma_m**2, 0.0]))
        covs.append(pipeline.step(drive.odometry[3], drive.scans[3]).corners.cov)
    assert (covs[0].diagonal() > covs[1].diagonal()).all() == added
    assert np.array_equal(covs[0], covs[1]) == (not added)


@pytest.mark.parametrize(("noise", "least"), [("paper", 1.7), ("none", 0.6)])
def test_the_pose_is_as_uncertain_as_it_is_wrong(noise, least):
    """NEES of the pose over drives in two rooms, 3 expected; less where what one linearisation neglects counts most."""
    slam, nees = SlamConfig(sensor=SensorModel(**NOISE[noise])), []
    for seed in range(5):
        run = scripted_drive(seed=seed, **NOISE[noise]).run(slam)
        nees.append(np.mean([e @ np.linalg.solve(output.belief.pose_cov, e) for _, output, _, e in run]))
    assert least < np.mean(nees) < 4.0


@pytest.mark.parametrize(
    ("field", "odometry", "scan"),
    [("scan.ranges", {}, {"ranges": np.full((4, 720), np.nan)}), ("odometry.cov", {"cov": -np.eye(2)[None]}, {})],
)
def test_damaged_input_is_refused_and_nothing_is_lost(drive, field, odometry, scan):
    pipeline = SlamPipeline(SlamConfig())
    before = pipeline.start(drive.scans[0])
    with pytest.raises(SensorError, match=field):
        pipeline.step(replace(drive.odometry[3], **odometry), replace(drive.scans[3], **scan))
    assert pipeline.step_count == before.step
    assert np.array_equal(pipeline.filter.belief().T_map_robot, before.belief.T_map_robot)


def spied(monkeypatch, cls, name):
    """The arguments of each call of a method from now on."""
    calls, real = [], getattr(cls, name)

    def spy(*args, **keywords):
        calls.append(inspect.signature(real).bind(*args, **keywords).arguments)
        return real(*args, **keywords)

    monkeypatch.setattr(cls, name, spy)
    return calls


@pytest.fixture
def mapping(drive):
    """A pipeline after the first scans of a drive, and the step that comes next."""
    pipeline = SlamPipeline()
    for _ in fed(pipeline, drive, last=12):
        pass
    return pipeline, (drive.odometry[12], drive.scans[12])


@pytest.mark.parametrize(("settled", "iterated"), [(True, [False]), (False, [False, True])])
def test_odometry_is_doubted_only_where_the_first_attempt_settles_nothing(mapping, monkeypatch, settled, iterated):
    """The first update is that of a sharp prediction; the second, of a loosened one, is iterated."""
    pipeline, step = mapping
    monkeypatch.setattr(Evidence, "fits", property(lambda _: False))
    monkeypatch.setattr(Evidence, "settles", lambda *_: settled)
    updates = spied(monkeypatch, PoseGuard, "update")
    pipeline.step(*step)
    assert [update["iterate"] for update in updates] == iterated


@pytest.mark.parametrize(
    ("nearly_fits", "clear", "same"),
    [(False, False, False), (True, False, False), (False, True, False), (False, False, True)],
)
def test_a_pose_of_failed_odometry_counts_where_the_first_nearly_fits_or_a_search_finds_it(
    mapping, monkeypatch, nearly_fits, clear, same
):
    """Otherwise another place may look like this one: the scan changes nothing, unless both poses are one place."""
    pipeline, step = mapping
    monkeypatch.setattr(Evidence, "fits", property(lambda _: False))
    monkeypatch.setattr(Evidence, "nearly_fits", property(lambda _: nearly_fits))
    monkeypatch.setattr(Evidence, "beats", lambda *_: True)
    monkeypatch.setattr(Evidence, "settles", lambda *_: False)
    monkeypatch.setattr(PoseGuard, "is_clear", lambda *_: clear)
    monkeypatch.setattr(PoseGuard, "is_same", lambda *_: same)
    pipeline.step(*step)
    assert pipeline.guard.is_sure == (nearly_fits or clear or same)


@pytest.mark.parametrize("wide", [False, True])
def test_tracks_are_confirmed_sooner_after_a_wide_prediction(mapping, monkeypatch, wide):
    pipeline, step = mapping
    pipeline.filter.loosen(np.diag([0.04, 0.04, 0.0]) * wide)
    tracked = spied(monkeypatch, LandmarkMap, "track")
    pipeline.step(*step)
    assert [call["wide"] for call in tracked] == [wide]


def test_while_the_pose_is_searched_for_nothing_is_associated_and_odometry_not_doubted_again(mapping, monkeypatch):
    pipeline, step = mapping
    pipeline.lose_pose()
    asked, judged = spied(monkeypatch, MecpAssociator, "associate"), spied(monkeypatch, PoseGuard, "evidence")
    pipeline.step(*step)
    assert (len(asked), len(judged)) == (0, 1)


@pytest.mark.parametrize("lost", [False, True])
def test_scans_with_enough_corners_are_registered_while_the_pose_is_searched_for(drive, mapping, monkeypatch, lost):
    pipeline, step = mapping
    if lost:
        pipeline.lose_pose()
        monkeypatch.setattr(PoseGuard, "search", lambda *_: None)
    pipeline.step(*step)
    pipeline.step(drive.odometry[13], drive.scans[13])  # with the one before
    assert (pipeline.recent.registered is not None) == lost


@pytest.mark.parametrize("found", [False, True])
def test_a_pose_that_is_found_empties_the_window_of_recent_scans(mapping, monkeypatch, found):
    pipeline, step = mapping
    pipeline.lose_pose()
    here = make.hypothesis((), at=pipeline.filter.belief().T_map_robot).at
    monkeypatch.setattr(PoseGuard, "search", lambda *_: here if found else None)
    monkeypatch.setattr(PoseGuard, "resumes", lambda *_: False)
    emptied = spied(monkeypatch, RecentScans, "forget")
    pipeline.step(*step)
    assert len(emptied) == found
