"""The window in the pipeline: polygons around a robot that does not see behind itself, without a worse pose."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from mecp_env.core.se2 import inside_polygon, polar_to_points
from mecp_env.slam.config import PanoramaConfig, SensorModel, SlamConfig
from tests.slam.drives import scripted_drive

HALF = {"field_of_view_deg": 180.0, "beams": 360}


def half(**fields):
    return SlamConfig(sensor=SensorModel(field_of_view_deg=180.0), **fields)


@pytest.fixture(scope="module")
def drive():
    return scripted_drive(seed=3, **HALF)


@pytest.fixture(scope="module")
def runs(drive):
    return list(drive.run(half()))


def test_polygons_surround_the_robot(runs):
    outputs = [output for _, output, *_ in runs]
    for output in outputs:  # corners of the past update nothing
        assert len(output.match.ids) == len(output.corners)
        assert (output.belief.ids >= 0).all()
        if output.panorama is not None:
            assert (np.diff(output.panorama.z[:, 1]) >= 0.0).all()
            assert len(output.panorama) >= len(output.corners)
    with_polygon = [o for o in outputs if any(len(polygon.corners) >= 4 for polygon in o.polygons)]
    assert len(with_polygon) >= 15  # the robot drives through a door, and the window begins again
    for output in with_polygon:
        for polygon in output.polygons:
            ring = polar_to_points(output.polygon_corners.z)[polygon.corners]
            assert inside_polygon(0.0, 0.0, ring)
    assert any(output.graph.in_doorway for output in with_polygon)


def test_the_window_is_as_long_as_configured(drive):
    config = half(panorama=PanoramaConfig(scans=3, spacing_m=0.3))
    *_, (pipeline, *_) = drive.run(config)
    assert len(pipeline.recent.scans) == 3
    marks = [mark for scan in pipeline.recent.scans for mark in scan.marks.tolist()]
    assert sorted(marks) == sorted(pipeline.filter.slot_ids[pipeline.filter.slot_ids < -1].tolist())


def test_a_full_view_has_a_window_only_while_scans_show_few_corners():
    short = scripted_drive(seed=3, max_range_m=3.0)
    runs = [(output, len(pipeline.recent.scans)) for pipeline, output, *_ in short.run(SlamConfig())]
    few = [len(output.corners) < SlamConfig().localisation.least_corners for output, _ in runs]
    assert [kept > 0 for _, kept in runs] == few
    assert 0.2 < np.mean(few) < 0.9
    assert all(output.panorama is None for output, _ in runs)  # no blind side is completed


def test_the_error_is_as_large_as_the_covariance_says():
    nees = []
    for seed in range(4):
        for _, output, _, error in scripted_drive(seed=10 + seed, **HALF).run(half()):
            nees.append(error @ np.linalg.solve(output.belief.pose_cov, error))
    assert np.mean(nees) < 4.0


def test_a_robot_that_is_carried_maps_nothing_at_the_wrong_place(drive, runs):
    """Its second scan there is registered with the first, which says nothing of where both are."""
    pipeline = copy.deepcopy(runs[-1][0])
    features = len(pipeline.map.features)
    for step in range(5, 9):
        output = pipeline.step(drive.odometry[step], drive.scans[step])
        assert pipeline.recent.registered is not None or step == 5
        assert not pipeline.recent.vouched or output.localised
        assert len(pipeline.map.features) == features
    assert not output.localised


@pytest.mark.parametrize("turn", [0.3, -0.2])
def test_wheels_that_slip_leave_the_pose_known_where_the_walls_tell_it(drive, turn):
    """The turn is found by the walls; how far it went, where nothing tells, is as unsure as odometry is then."""
    steps = range(10, len(drive.scans) - 1, 8)
    runs = [copy.deepcopy(pipeline) for pipeline, *_ in drive.run(half())]
    for step in steps:
        right, scan = drive.odometry[step + 1], drive.scans[step + 1]
        slipped = replace(right, increments=right.increments * [2.0, 1.0] + [0.0, turn / len(right.increments)])
        output = runs[step].step(slipped, scan)
        error = output.belief.T_map_robot - drive.T_map_robot[step + 1]
        assert abs(error[2]) < 0.02
        assert error @ np.linalg.solve(output.belief.pose_cov, error) < 15.0
