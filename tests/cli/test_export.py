"""`mecp-env export`: a saved map for other programs."""

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest
from shapely.geometry import shape

from mecp_env.cli.main import main
from mecp_env.slam import Odometry, Scan, SlamMap, SlamPipeline

ANGLES = np.linspace(-math.pi, math.pi, 721)[1:]
ROOM = np.minimum(3.0 / np.maximum(np.abs(np.cos(ANGLES)), 1e-9), 2.0 / np.maximum(np.abs(np.sin(ANGLES)), 1e-9))


@pytest.fixture
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pipeline = SlamPipeline()
    pipeline.start(Scan.of(ROOM, ANGLES, 30.0))
    for _ in range(4):
        pipeline.step(Odometry.between(np.zeros(3), np.zeros(3), (0.01, 0.01)), Scan.of(ROOM, ANGLES, 30.0))
    path = tmp_path_factory.mktemp("map") / "map.zip"
    SlamMap.of(pipeline).save(path)
    return path


def test_every_file_holds_the_map(saved: Path, tmp_path: Path) -> None:
    names = {"landmarks": "x.csv", "rooms": "x.geojson", "g2o": "x.g2o", "grid": "x.yaml"}
    options = [word for name, file in names.items() for word in (f"--{name}", str(tmp_path / file))]
    assert main(["export", str(saved), *options]) == 0
    rows = list(csv.DictReader((tmp_path / "x.csv").open()))
    assert len(rows) == 4
    assert all(float(row["var_x_m2"]) > 0.0 for row in rows)
    features = json.loads((tmp_path / "x.geojson").read_text())["features"]
    (room,) = [shape(f["geometry"]) for f in features if f["properties"]["kind"] == "room"]
    assert room.is_valid
    assert room.area == pytest.approx(24.0, rel=0.1)
    assert room.exterior.is_ccw
    kinds = [line.split()[0] for line in (tmp_path / "x.g2o").read_text().splitlines()]
    assert (kinds.count("VERTEX_SE2"), kinds.count("VERTEX_XY"), kinds.count("EDGE_SE2_XY")) == (1, 4, 4)


def test_no_file_is_written_over_another(saved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image, sheet = tmp_path / "a.pgm", tmp_path / "." / "a.yaml"  # which has an image of its name
    assert main(["export", str(saved), "--landmarks", str(image), "--grid", str(sheet)]) == 2
    assert "name another file" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
    assert main(["export", str(saved)]) == 2  # nothing to write
    assert "--landmarks" in capsys.readouterr().err
