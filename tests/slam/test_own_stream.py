"""A user's own stream of scans and odometry: any bearing convention, poses of the wheels, a laser by its name."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mecp_env.core.errors import ConfigError
from mecp_env.core.se2 import compose
from mecp_env.slam import Odometry, Scan, SensorError
from mecp_env.slam.config import SensorModel
from tests.slam.scans import cast, moved, ring

B = 360
ANGLES = np.linspace(-math.pi, math.pi, B + 1)[1:]
ROOM = cast(ring((3.0, -2.0), (3.0, 2.0), (-3.0, 2.0), (-3.0, -2.0)), ANGLES)
WALLS = ring((2.0, -1.5), (2.0, 1.5), (-2.0, 1.5), (-2.0, -1.5))


@pytest.mark.parametrize(
    ("bearings", "clockwise", "order"),
    [(np.mod(ANGLES, 2.0 * math.pi), False, 1), (-ANGLES, True, -1), (ANGLES - 20.0 * math.pi, False, -1)],
)
def test_a_scan_is_the_same_in_every_bearing_convention(bearings: np.ndarray, clockwise: bool, order: int) -> None:
    scan = Scan.of(ROOM[::order].astype(np.float32), bearings[::order], 30.0, clockwise=clockwise)
    np.testing.assert_allclose(scan.bearings[0], ANGLES, atol=1e-6)
    np.testing.assert_allclose(scan.ranges[0], ROOM, rtol=1e-6)
    assert scan.hit.all()


def test_what_did_not_return_is_no_hit() -> None:
    scan = Scan.of([math.nan, math.inf, 0.0, 5.0, 2.0], [0.0, 0.1, 0.2, 0.3, 0.4], 5.0)
    assert scan.hit.tolist() == [[False, False, False, False, True]]
    assert scan.ranges.tolist() == [[5.0, 5.0, 5.0, 5.0, 2.0]]


def test_wrong_shapes_are_named() -> None:
    with pytest.raises(SensorError, match="shapes"):
        Scan.of([1.0, 2.0], [0.0], 5.0)
    with pytest.raises(SensorError, match="max_range_m"):
        Scan.of([1.0], [0.0], 0.0)
    with pytest.raises(SensorError, match="bearings: from -180 to 179, within a turn in rad expected"):
        Scan.of(np.ones(360), np.arange(-180.0, 180.0), 5.0)
    with pytest.raises(SensorError, match="noise"):
        Odometry.between(np.zeros(3), np.zeros(3), (0.0, 0.1))


@pytest.mark.parametrize("motion", [(0.4, 0.2, 0.3), (-0.5, 0.1, -0.2), (0.0, 0.3, 0.0), (0, 0, 1)])
def test_the_arcs_between_two_poses_lead_from_one_to_the_other(motion: tuple[float, float, float]) -> None:
    before = np.array([3.0, -1.0, 2.8])
    after = compose(before, np.array(motion, np.float64))
    odometry = Odometry.between(before, after, (0.02, 0.01))
    reached = before
    for distance, turn in odometry.increments:
        arc = np.array([distance * math.cos(turn / 2.0), distance * math.sin(turn / 2.0), turn])
        reached = compose(reached, arc)
    np.testing.assert_allclose(reached[:2], after[:2], atol=2e-3)
    assert math.remainder(reached[2] - after[2], 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(odometry.cov.sum(axis=0), np.diag([4e-4, 1e-4]))


def test_a_laser_by_its_name() -> None:
    sensor = SensorModel.preset("urg04lx", heading_deg=90.0)
    assert (sensor.range_sigma_share, sensor.field_of_view_deg, sensor.heading_deg) == (0.01, 239.77, 90.0)
    with pytest.raises(ConfigError, match="urg04lx"):
        SensorModel.preset("urg04")


def test_the_ten_lines_of_the_page_map_a_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A room seen by a laser with a blind side, 10 cm ahead of the robot's centre, which turns once on the spot."""
    page = (Path(__file__).parents[2] / "docs" / "estimator.md").read_text(encoding="utf-8")
    code = page.partition("<!-- tests/slam/test_own_stream.py runs this -->\n```python\n")[2].partition("```")[0]
    imports, body = code.split("\n\n", 1)
    assert len(body.strip().splitlines()) <= 10
    bearings = np.radians(np.linspace(-119.0, 119.0, 477))
    headings = [math.radians(10.0 * k) for k in range(37)]
    seen = [cast(moved(WALLS, (0.0, 0.0, turn)) - [0.1, 0.0], bearings).astype(np.float32) for turn in headings]
    stream = iter([(np.array([0.0, 0.0, heading]), ranges) for heading, ranges in zip(headings, seen, strict=True)])
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"stream": stream, "bearings": bearings}
    exec(f"{imports}\n{body}", names)
    belief = names["output"].belief
    assert len(belief.ids) == 4
    corners = sorted(np.abs(belief.p_map).round(1).tolist())
    assert corners == [[2.0, 1.5]] * 4
    assert {path.name for path in tmp_path.iterdir()} == {"x.csv", "x.geojson", "x.g2o", "x.yaml", "x.pgm", "x.npz"}
