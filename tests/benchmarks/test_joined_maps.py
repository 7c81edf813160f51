"""Maps side by side: nothing of them is lost, nothing overlaps, and a robot localises in each of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.joined_maps import Joined, join
from mecp_env.core.se2 import compose, inverse
from mecp_env.slam import SlamMap, SlamPipeline
from mecp_env.slam.map_file import place
from tests.slam.drives import Drive, fed, scripted_drive


@pytest.fixture(scope="module")
def drive() -> Drive:
    return scripted_drive()


@pytest.fixture(scope="module")
def maps(drive: Drive, tmp_path_factory: pytest.TempPathFactory) -> list[SlamPipeline]:
    """Three maps from files: of the whole drive, of a part of it, and of the whole one again."""
    paths: list[Path] = [tmp_path_factory.mktemp("maps") / f"{k}.zip" for k in range(3)]
    for path, last in zip(paths, (len(drive.scans), 50, len(drive.scans)), strict=True):
        pipeline = SlamPipeline()
        list(fed(pipeline, drive, last=last))
        pipeline.save_map(path)
    return [SlamPipeline.from_map(path) for path in paths]


@pytest.fixture(scope="module")
def joined(maps: list[SlamPipeline]) -> Joined:
    return join(maps)


def test_every_landmark_is_there_with_its_joint_covariance(maps: list[SlamPipeline], joined: Joined) -> None:
    pipeline = joined.pipeline
    assert len(pipeline.filter.ids) == sum(len(one.filter.ids) for one in maps)
    for one, shift, first in zip(maps, joined.shifts, joined.first_feature, strict=True):
        mean, cov = one.filter.marginal(one.filter.ids)
        moved, moved_cov = pipeline.filter.marginal(one.filter.ids + first)
        np.testing.assert_allclose(moved[3:].reshape(-1, 2), mean[3:].reshape(-1, 2) + shift, atol=1e-12)
        np.testing.assert_allclose(moved_cov[3:, 3:], cov[3:, 3:], atol=1e-15)
    ids = np.array([maps[0].filter.ids[0], maps[1].filter.ids[0] + joined.first_feature[1]])
    np.testing.assert_allclose(pipeline.filter.marginal(ids)[1][3:5, 5:7], 0.0, atol=1e-15)
    pose, first_pose = pipeline.filter.belief(), maps[0].filter.belief()
    np.testing.assert_allclose(pose.T_map_robot, first_pose.T_map_robot + np.append(joined.shifts[0], 0.0))
    np.testing.assert_allclose(pose.pose_cov, first_pose.pose_cov, atol=1e-15)


def test_maps_do_not_overlap(maps: list[SlamPipeline], joined: Joined) -> None:
    boxes = []
    for one, shift in zip(maps, joined.shifts, strict=True):
        p_map = one.filter.belief().p_map + shift
        boxes.append((p_map.min(axis=0), p_map.max(axis=0)))
    for k, (low, high) in enumerate(boxes):
        assert all(
            (low > other_high + 1.9).any() or (high < other_low - 1.9).any() for other_low, other_high in boxes[:k]
        )


def test_features_polygons_rooms_and_doors_have_new_numbers(maps: list[SlamPipeline], joined: Joined) -> None:
    pipeline, graph = joined.pipeline, joined.pipeline.rooms.graph()
    assert len(graph.rooms) == len(set(graph.rooms)) == 6
    assert len(graph.doors) == len({door.id for door in graph.doors}) == 3
    assert len(pipeline.map.polygons.polygons) == sum(len(one.map.polygons.polygons) for one in maps)
    for door in graph.doors:
        assert pipeline.filter.has(door.jambs[0])
        assert set(door.rooms) <= set(graph.rooms)
    rows, rooms = pipeline.map.features.rows, pipeline.rooms
    for polygon in pipeline.map.polygons.polygons:
        assert {rooms.resolve(int(room)) for room in rows["room"][polygon.ids]} == {polygon.room}
    assert sum(len(group.ids) for group in pipeline.map.polygons.groups.values()) == len(pipeline.map.polygons.polygons)


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_robot_localises_in_each_of_them(number: int, drive: Drive, joined: Joined) -> None:
    pipeline = SlamPipeline.from_map(SlamMap.of(joined.pipeline))
    start = [compose(inverse(drive.T_world_robot[0]), pose) for pose in drive.T_world_robot[20:30]]
    place(pipeline, start[0] + np.append(joined.shifts[number], 0.1), np.diag([0.1, 0.1, 0.04]))
    before = set(pipeline.filter.ids.tolist())
    outputs = [pipeline.start(drive.scans[20])]
    outputs += [pipeline.step(drive.odometry[k], drive.scans[k]) for k in range(21, 30)]
    for output, true in zip(outputs, start, strict=True):
        assert np.abs(output.belief.T_map_robot - true - np.append(joined.shifts[number], 0.0)).max() < 0.05
    first, last = joined.first_feature[number], [*joined.first_feature[1:], 10_000][number]
    recognised = np.concatenate([output.match.ids[output.match.recognised()] for output in outputs])
    assert ((recognised >= first) & (recognised < last)).all()
    assert len(set(pipeline.filter.ids.tolist()) - before) <= 1
