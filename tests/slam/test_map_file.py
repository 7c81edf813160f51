"""Maps on disk: a loaded map goes on to the bit, a robot can be put into it, and whatever is wrong gives one error."""

import copy
import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mecp_env.core.errors import ConfigError
from mecp_env.core.snapshot import encode
from mecp_env.evaluation.ground_truth import true_correspondences
from mecp_env.slam import MapError, SlamConfig, SlamMap, SlamPipeline
from mecp_env.slam.association import MecpAssociator
from mecp_env.slam.association.oracle import NoCorrespondences
from mecp_env.slam.filters import RightInvariantEkf, SubmapEkf, make_filter
from mecp_env.slam.filters.oracle import OraclePoseFilter
from mecp_env.slam.map_file import place
from mecp_env.slam.messages import FeatureState
from tests.env.helpers import same
from tests.env.test_state_fuzz import PARTS, mutate, nodes
from tests.slam.drives import Drive, Given, fed, scripted_drive

CHANGED = 30  # maps with changed fields; the benchmark `mutated` has files with changed bytes, too
OTHER = {"filter": {"kind": "fej"}, "grid": {"resolution_m": 0.2}, "dynamic_objects": {"margin_m": 0.0}}
CONFIGS: dict[str, dict[str, Any]] = {"paper": SlamConfig.paper().model_dump(), "other": OTHER}


@pytest.fixture(scope="module")
def saved(mapped: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The map of the whole drive, which ends in the first room."""
    path = tmp_path_factory.mktemp("maps") / "two_rooms.zip"
    mapped[0].save_map(path)
    return path


def run(pipeline: SlamPipeline, drive: Drive, first: int, last: int) -> list[Any]:
    """The outputs on a part of the drive."""
    return list(fed(pipeline, drive, first, last))


@pytest.mark.parametrize("name", CONFIGS)
def test_a_loaded_map_goes_on_to_the_bit(name: str, drive: Drive, tmp_path: Path) -> None:
    """Also where it was saved with tracks that wait, in a doorway, in the second room: every part of the way."""
    pipeline, last = SlamPipeline(CONFIGS[name]), len(drive.scans)
    for first, end in pairwise((0, 2, 16, 29, 48)):
        run(pipeline, drive, first, end)
        pipeline.save_map(tmp_path / "map.zip")
        other = SlamPipeline.from_map(tmp_path / "map.zip")
        assert same(encode(other), encode(pipeline))
        assert other.config == SlamConfig.parse(CONFIGS[name])
    assert same(run(pipeline, drive, end, last), run(other, drive, end, last))
    assert same(encode(other), encode(pipeline))


@pytest.mark.parametrize("first", [5, 35])
@pytest.mark.parametrize("known", [True, False], ids=["roughly known", "unknown"])
def test_a_robot_put_into_a_map_is_found_and_maps_on(first: int, known: bool, drive: Drive, saved: Path) -> None:
    """In either room, with half a metre of error or at an unknown place, where it maps nothing before it is found."""
    start = drive.T_map_robot[first - 1] + np.array([0.4, -0.3, 0.2])
    put = SlamPipeline.from_map(saved, start if known else "unknown")
    features, landmarks = len(put.map.features), put.filter.ids.tolist()
    assert not (put.map.features.rows["state"] == FeatureState.TRACK).any()
    for output, true in zip(fed(put, drive, first, first + 15), drive.T_map_robot[first:], strict=False):
        assert output.localised or not known
        assert (output.confidence > 0.5) == output.localised
        if output.localised:
            assert np.abs(output.belief.T_map_robot - true)[:2].max() < 0.05
        else:
            assert len(put.map.features) == features
    assert output.localised
    assert set(landmarks) <= set(output.belief.ids.tolist())
    assert len(output.belief.ids) <= len(landmarks) + 1
    assert output.graph.current == (0 if true[0] < 3.0 else 1)
    assert output.step == len(drive.scans) + 15


def test_an_unknown_start_does_not_favour_the_saved_pose(tmp_path: Path) -> None:
    """Two rooms are equal: a robot saved in one and now in the other was once taken to be where it was saved."""
    places = ((5.0, 2.0), (7.0, 2.0), (9.0, 2.0), (10.0, 3.0), (10.0, 5.0), (10.0, 7.5), (10.0, 10.5))
    drive = scripted_drive("twins", places)
    pipeline = SlamPipeline()
    run(pipeline, drive, 0, len(drive.scans))
    south = [k for k, pose in enumerate(drive.T_world_robot) if 5.0 < pose[0] < 7.0]
    x, y, heading = drive.T_world_robot[south[0] - 1]  # before the first step
    east = np.array([10.0 - (y - 2.0), 6.0 + (x - 6.0), heading + math.pi / 2.0])
    place(pipeline, drive.in_map(east), np.diag([1e-4, 1e-4, 1e-4]))
    pipeline.save_map(tmp_path / "map.zip")
    for output in run(SlamPipeline.from_map(tmp_path / "map.zip", "unknown"), drive, south[0], south[-1] + 1):
        assert not output.localised


@pytest.mark.parametrize(
    ("start", "sigmas", "message"),
    [
        ("here", (1, 1, 1), "start: 'here', expected"),
        ((1e6, 0.0, 0.0), (1, 1, 1), "start: .* above -500 and below 500"),
        ((0.0, 0.0, 0.0), (1, 1, 0), r"sigmas: \(1, 1, 0\), .* above 0"),
    ],
)
def test_a_start_that_is_none_is_named(start: Any, sigmas: Any, message: str, saved: Path) -> None:
    with pytest.raises(ConfigError, match=message):
        SlamPipeline.from_map(saved, start, sigmas=sigmas)


def test_ground_truth_stays_out_of_a_map(drive: Drive) -> None:
    known = SlamPipeline({"association": {"method": "known"}})
    known.associator.correspondences = true_correspondences(drive.T_world_robot[0], drive.outline)
    run(known, drive, 0, 3)
    assert isinstance(SlamPipeline.from_map(SlamMap.of(known)).associator.correspondences, NoCorrespondences)
    assert not isinstance(known.associator.correspondences, NoCorrespondences)
    placed = SlamPipeline(filter=OraclePoseFilter(make_filter(SlamConfig().filter)))
    run(placed, drive, 0, 5)
    assert type(SlamPipeline.from_map(SlamMap.of(placed)).filter) is SubmapEkf


class OtherFilter(RightInvariantEkf):
    """A filter that no configuration names."""


def test_a_map_holds_the_parts_that_its_configuration_names(drive: Drive) -> None:
    config = SlamConfig()
    injected = SlamPipeline(associator=Given(MecpAssociator(config.association).associate))
    run(injected, drive, 0, 5)
    assert type(SlamPipeline.from_map(SlamMap.of(injected)).associator) is MecpAssociator
    with pytest.raises(MapError, match="filter: OtherFilter was injected"):
        SlamMap.of(SlamPipeline(filter=OtherFilter(config.filter)))


def changed(slam_map: SlamMap, path: str, value: Any) -> SlamMap:
    """A map with another value of a field of the pipeline; `...` leaves it out."""
    state = copy.deepcopy(slam_map.state)
    *parents, name = path.split(".")
    fields = state["@object"][1]
    for parent in parents:
        fields = fields[parent]["@object"][1]
    fields[name] = value
    if value is ...:
        del fields[name]
    return replace(slam_map, state=state)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("grid", ..., "map: missing or unknown grid"),
        ("step_count", "x", "map.step_count: expected int, given 'x'"),
        ("filter.slot_ids", {"@array": [np.arange(3), True]}, "map.map.features.rows: a landmark that is not in"),
        ("map.features.rows", {"@array": [np.zeros(3), True]}, "map.map.features.rows: expected (?i:ndarray)"),
        ("config", {"@settings": ["mecp_env.slam.config:SlamConfig", {"speed": 1}]}, "SlamConfig.speed: no such field"),
        ("grid", {"@object": ["os:system", {}]}, "state: 'os:system' is not a class of mecp_env"),
        ("grid.canvas.resolution_m", 0.07, r"grid\.canvas\.resolution_m: 0\.07, configured"),
        ("filter.slot_ids", {"@array": [np.arange(-500, 500), True]}, r"filter: state .* for slot_ids \(1000,\)"),
    ],
)
def test_a_damaged_map_names_the_file_and_the_field(
    path: str, value: Any, message: str, saved: Path, tmp_path: Path
) -> None:
    file = tmp_path / "other.zip"
    changed(SlamMap.load(saved), path, value).save(file)
    with pytest.raises(MapError, match=rf"other\.zip: .*{message}"):
        SlamPipeline.from_map(file)


def test_maps_with_changed_fields_end_in_one_error_or_run(drive: Drive, saved: Path) -> None:
    """As those of environments in `tests.env.test_state_fuzz`, by the same changes."""
    whole, refused = SlamMap.load(saved), 0
    known = nodes(dict.fromkeys(PARTS, whole.state))
    for seed in range(CHANGED):
        state = copy.deepcopy(whole.state)
        mutate(dict.fromkeys(PARTS, state), known, np.random.default_rng(seed))
        try:
            pipeline = SlamPipeline.from_map(replace(whole, state=state))
        except MapError:
            refused += 1
            continue
        run(pipeline, drive, 3, 6)
    assert 0.3 * CHANGED < refused < CHANGED
