"""The benchmark `map_size`: copies of a map are a map."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import loop, map_size
from benchmarks.common import Options
from benchmarks.drives import Drive
from benchmarks.tables import report_of
from benchmarks.variants import associators
from mecp_env.core.intervals import estimate
from mecp_env.slam.config import KINDS


@pytest.fixture(scope="module")
def drive() -> Drive:
    course = loop.course("paper", map_size.SEED)
    return type(course)(course.layout, course.seed, course.fields | {"max_steps": 130}).drive()


def test_a_map_of_copies_has_as_many_landmarks_and_its_polygons(drive: Drive) -> None:
    count = 60
    pipeline, number = map_size.enlarged(drive, drive.slam, count)
    first, _ = map_size.enlarged(drive, drive.slam, map_size.FIRST)
    belief, own, polygons = pipeline.filter.belief(), first.filter.belief(), pipeline.map.polygons
    copied = belief.p_map[:, 0] > map_size.APART_M / 2
    assert copied.sum() == len(belief.ids) - len(own.ids)
    assert count <= len(belief.ids) <= max(count, map_size.FIRST + 3) + 1  # several are confirmed in one scan
    np.testing.assert_allclose(belief.p_map[~copied], own.p_map, atol=0.02)
    whole = belief.p_map[copied][: len(own.ids) - 1] - [map_size.APART_M, 0.0]
    np.testing.assert_allclose(whole, own.p_map[: len(whole)], atol=0.05)
    assert len(polygons.polygons) == sum(len(group.index) for group in polygons.groups.values())
    assert len(polygons.polygons) >= len(first.map.polygons.polygons) * (count // len(own.ids))
    assert 0 < number < len(drive.scans) - map_size.SCANS


def test_every_registered_part_has_a_row(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(map_size, "in_parallel", lambda task, kind, units, options: [[1.0, 2.0]] * len(units))
    figures = map_size.run(Options(quick=True, folder=tmp_path))
    assert list(figures["filters"]) == [*KINDS.ours, *KINDS.others]
    assert set(figures["associators"]) == set(associators()) - {"known"}
    assert figures["filters"]["ekf"] == {"25": estimate([1.0, 2.0]), "50": estimate([1.0, 2.0])}
    assert "| riekf_submaps |" in report_of(figures)
    assert [axes.get_title() for axes in map_size.figure(figures).axes] == ["filters", "associators"]


def test_every_part_gives_a_time_per_scan_of_a_drive_with_enough_landmarks(drive: Drive) -> None:
    short = Drive(drive.truth, drive.slam, drive.odometry[:3], drive.scans[:3], drive.T_world_robot[:3])
    with pytest.raises(ValueError, match="landmarks, 25 expected"):
        map_size.enlarged(short, drive.slam, 50)
    for timed, name in (
        (map_size.step_ms, "ekf"),
        (map_size.association_ms, "mecp"),
        (map_size.association_ms, "jcbb"),
    ):
        ms = timed(drive, name, 50)
        assert len(ms) == map_size.SCANS
        assert min(ms) > 0.0
