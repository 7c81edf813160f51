"""Files for other programs: one implementation for outputs, pipelines and the command; outlines against shapely."""

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from shapely.geometry import shape

from mecp_env.cli.main import main
from mecp_env.core.errors import ConfigError
from mecp_env.slam import Odometry, Scan, SlamConfig, SlamPipeline
from mecp_env.slam.config import SensorModel
from mecp_env.slam.export import area, door_outline, room_outline
from tests.slam import make
from tests.slam.scans import cast, ring

FILES = {"landmarks": "x.csv", "rooms": "x.geojson", "g2o": "x.g2o", "grid": "x.yaml"}


def test_output_pipeline_and_command_write_the_same_files(mapped: Any, tmp_path: Path) -> None:
    pipeline, output, _ = mapped
    folders = {name: tmp_path / name for name in ("output", "pipeline", "command")}
    written = output.export(**{name: folders["output"] / file for name, file in FILES.items()})
    assert sorted(path.name for path in written) == ["x.csv", "x.g2o", "x.geojson", "x.pgm", "x.yaml"]
    pipeline.export(**{name: folders["pipeline"] / file for name, file in FILES.items()})
    pipeline.save_map(tmp_path / "map.zip")
    options = [word for name, file in FILES.items() for word in (f"--{name}", str(folders["command"] / file))]
    assert main(["export", str(tmp_path / "map.zip"), *options]) == 0
    for path in written:
        for folder in folders.values():
            assert (folder / path.name).read_bytes() == path.read_bytes()
    landmarks = list(csv.DictReader((folders["output"] / "x.csv").open()))
    assert all(float(row["var_x_m2"]) > 0.0 for row in landmarks)
    kinds = [text.split()[0] for text in (folders["output"] / "x.g2o").read_text().splitlines()]
    assert [kinds.count(kind) for kind in ("VERTEX_SE2", "VERTEX_XY", "EDGE_SE2_XY")] == [1, *[len(landmarks)] * 2]
    outlines = json.loads((folders["output"] / "x.geojson").read_text())["features"]
    assert [outline["properties"]["kind"] for outline in outlines] == ["room", "room", "door"]
    assert sorted(outlines[2]["properties"]["rooms"]) == [0, 1]
    assert 0.05 < shape(outlines[2]["geometry"]).area < 0.5


def test_the_joint_covariance_is_that_of_the_robots_centre_and_names_its_rows(tmp_path: Path) -> None:
    angles = np.linspace(-math.pi, math.pi, 361)[1:]
    ranges = cast(ring((3.0, -2.0), (3.0, 2.0), (-3.0, 2.0), (-3.0, -2.0)), angles)
    pipeline = SlamPipeline(SlamConfig(sensor=SensorModel.preset("rplidar_a1", x_m=0.3, y_m=-0.2)))
    pipeline.start(Scan.of(ranges, angles, 12.0))
    for _ in range(4):
        output = pipeline.step(Odometry.between(np.zeros(3), np.zeros(3), (0.01, 0.01)), Scan.of(ranges, angles, 12.0))
    belief = output.belief
    pipeline.export(joint_covariance=tmp_path / "joint.npz")
    pipeline.export(joint_covariance=tmp_path / "joint.csv")
    with np.load(tmp_path / "joint.npz") as file:
        ids, mean, cov = file["ids"], file["mean"], file["cov"]
    assert ids.tolist() == belief.ids.tolist() == [0, 1, 2, 3]
    np.testing.assert_allclose(mean, [*belief.T_map_robot, *belief.p_map.ravel()], atol=1e-9)
    np.testing.assert_allclose(cov[:3, :3], belief.pose_cov, atol=1e-15)
    np.testing.assert_allclose([cov[k : k + 2, k : k + 2] for k in range(3, 11, 2)], belief.covs, atol=1e-12)
    names, *rows = csv.reader((tmp_path / "joint.csv").open())
    columns = ["pose.x_m", "pose.y_m", "pose.heading_rad", *(f"{i}.{axis}_m" for i in ids for axis in "xy")]
    assert names == ["", "mean", *columns]
    assert [row[0] for row in rows] == columns
    np.testing.assert_array_equal(np.array([row[1:] for row in rows], float), np.column_stack([mean, cov]))


UNWRITABLE = {"": "landmarks", "landmark x.csv": "landmarks", "grid x.png": "x.png"}
UNWRITABLE |= {"joint_covariance x.txt": "npz", "joint_covariance x.npz": "SlamPipeline"}


def test_what_an_output_cannot_write_is_named(mapped: Any, tmp_path: Path) -> None:
    for words, named in UNWRITABLE.items():
        name, _, path = words.partition(" ")
        with pytest.raises(ConfigError, match=named):
            mapped[1].export(**({name: tmp_path / path} if name else {}))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("seed", range(8))
def test_the_outline_of_any_cells_is_their_union(seed: int) -> None:
    rng = np.random.default_rng(seed)
    room = np.where(rng.random((9, 13)) < rng.uniform(0.2, 0.9), 0, -1).astype(np.int16)
    parts = room_outline(make.grid(room >= 0, room, origin=(1.0, -2.0), resolution_m=0.5), 0)
    polygons = [shapely.Polygon(rings[0], rings[1:]) for rings in parts]
    assert all(polygon.is_valid for polygon in polygons)
    assert all(area(rings[0]) > 0.0 and all(area(hole) < 0.0 for hole in rings[1:]) for rings in parts)
    cells = [shapely.box(x / 2 + 1, y / 2 - 2, x / 2 + 1.5, y / 2 - 1.5) for y, x in np.argwhere(room == 0)]
    assert shapely.union_all(polygons).symmetric_difference(shapely.union_all(cells)).area == pytest.approx(0.0)
    assert sum(polygon.area for polygon in polygons) == pytest.approx(0.25 * len(cells))


@pytest.mark.parametrize(("faces", "turn"), [(1, 0.7), (2, 0.0), (2, 2.0)])
def test_the_outline_of_a_door(faces: int, turn: float) -> None:
    across = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    points = np.array([[0.0, 0.0], [0.9, 0.0], [0.0, 0.2], [0.9, 0.2]]) @ across
    ring = door_outline(make.belief(p_map=points), make.door(other_face=(2, 3) if faces == 2 else None), 0.1)
    assert area(ring) == pytest.approx(0.9 * (0.2 if faces == 2 else 0.1))
    assert shapely.Polygon(ring).is_valid
