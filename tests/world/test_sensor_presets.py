"""Lasers and wheels that exist: their statistics are those of the data sheets (docs/sensors.md)."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mecp_env.config import EnvConfig
from mecp_env.core.errors import ConfigError
from mecp_env.core.sensors import LASERS
from mecp_env.world.config import WHEELS, LaserConfig, OdometryConfig
from mecp_env.world.laser import Laser
from mecp_env.world.layout import load_layout
from mecp_env.world.odometry import measure
from mecp_env.world.outline import Outline, build_outline
from tests.world.make import motion

SHEETS = {  # sigma (m) by distance (m)
    "lms200": {1.0: 0.01, 5.0: 0.01, 20.0: 0.01},
    "urg04lx": {0.5: 0.01, 1.0: 0.01, 2.0: 0.02, 4.0: 0.04},
    "utm30lx": {1.0: 0.01, 10.0: 0.01, 28.0: 0.028},
    "rplidar_a1": {0.2: 0.002, 1.0: 0.01, 5.0: 0.05, 10.0: 0.1},
}
LONG_M, WIDE_M = 60.0, 20.0


@pytest.fixture(scope="module")
def hall() -> Outline:
    """A room of 60 m x 20 m, its lower left corner at the origin, for the laser alone."""
    ring = np.array([(0.0, 0.0), (LONG_M, 0.0), (LONG_M, WIDE_M), (0.0, WIDE_M)])
    faces = np.stack([ring, np.roll(ring, -1, axis=0)], axis=1)  # the floor on the left
    return replace(build_outline(load_layout("two_rooms")), segments=faces)


@pytest.mark.parametrize(("name", "distance_m"), [(name, r) for name in SHEETS for r in SHEETS[name]])
def test_range_noise_is_that_of_the_sheet(hall: Outline, name: str, distance_m: float) -> None:
    """Of 1,500 beams or more, square to a wall: unbiased, with the sheet's standard deviation at that range."""
    config, rng = LaserConfig(preset=name, dark_share=0.0), np.random.default_rng(3)
    laser, pose = Laser(hall, config), np.array([LONG_M - distance_m - config.x_m, 0.5 * WIDE_M, 0.0])
    square = np.abs(laser.scan(pose, rng).bearings) < math.radians(2.0)
    true = distance_m / np.cos(laser.scan(pose, rng).bearings[square])
    scans = [laser.scan(pose, rng) for _ in range(1500 // square.sum() + 1)]
    errors = np.concatenate([scan.ranges[square] - true for scan in scans]) / SHEETS[name][distance_m]
    assert errors.mean() == pytest.approx(0.0, abs=4.0 / math.sqrt(len(errors)))
    assert errors.std() == pytest.approx(1.0, abs=0.07)


def test_nothing_returns_from_a_slanting_wall(hall: Outline) -> None:
    """Along the wall in the south, 1 m to the right of the robot."""
    config = LaserConfig(preset="lms200", range_sigma_m=0.0, x_m=0.0, beams=1800)
    laser, pose = Laser(hall, config), np.array([5.0, 1.0, 0.0])
    scan = laser.scan(pose, np.random.default_rng(0))
    incidence = math.pi / 2 + scan.bearings[0]  # of beams to the right
    on_wall = (scan.bearings[0] < 0.0) & (np.tan(incidence) < LONG_M - 5.0 - 1.0)
    seen = incidence < math.radians(config.grazing_deg)
    assert np.array_equal(scan.hit[0][on_wall], seen[on_wall])
    assert (scan.ranges[0][on_wall & ~seen] == config.max_range_m).all()


def test_dark_walls_swallow_their_share(hall: Outline) -> None:
    """Each wall is dark or not for a whole episode; of a dark one the named share of the beams does not return."""
    config = LaserConfig(preset="utm30lx", dark_share=0.5, dark_dropout=0.3, grazing_deg=90.0)
    shares = []
    for seed in range(30):
        laser, rng = Laser(hall, config, seed), np.random.default_rng(0)
        scans = [laser.scan(np.array([LONG_M - 3.0, 0.5 * WIDE_M, 0.0]), rng) for _ in range(20)]
        ahead = np.abs(scans[0].bearings) < math.radians(20.0)
        shares.append(1.0 - np.mean([scan.hit[ahead] for scan in scans]))
    dark = np.array(shares) > 0.1
    assert 6 < dark.sum() < 24
    assert np.array(shares)[dark] == pytest.approx(np.full(dark.sum(), 0.3), abs=0.04)
    assert not np.array(shares)[~dark].any()


def test_single_fields_override_a_preset() -> None:
    laser = LaserConfig(preset="urg04lx", max_range_m=4.0)
    assert (laser.max_range_m, laser.beams, laser.range_sigma_share) == (4.0, 682, 0.01)
    config = EnvConfig.build(laser={"preset": "urg04lx"})
    assert EnvConfig.build(config.to_dict(), laser={"preset": "paper"}).laser == LaserConfig()
    wheels = OdometryConfig(preset="skid_steer", slip_share=0.0)
    assert (wheels.slip_share, wheels.turn_sigma_deg) == (0.0, WHEELS["skid_steer"]["turn_sigma_deg"])
    assert SHEETS.keys() == LASERS.keys() - {"paper", "ideal"}
    for section, known in (("laser", LASERS), ("odometry", WHEELS)):
        with pytest.raises(ConfigError) as refused:
            EnvConfig.build({section: {"preset": "urg04lz"}})
        assert [name for name in known if f"'{name}'" not in str(refused.value)] == []


def test_wheels_slip_in_their_share_of_the_steps() -> None:
    config, rng = OdometryConfig(slip_share=0.2, scale=0.0), np.random.default_rng(7)
    ahead, at_rest = motion((0.1, 0.0), steps=4), motion((0.0, 0.0), steps=4)
    far, aside = np.array([measure(ahead, config, rng).increments.sum(axis=0) for _ in range(5000)]).T
    slipped = far > 0.4 + 1e-12
    assert slipped.mean() == pytest.approx(0.2, abs=0.02)
    assert far.max() < 0.4 * config.slip_most
    assert aside[slipped].std() == pytest.approx(math.radians(config.slip_turn_deg), rel=0.1)
    assert not aside[~slipped].any()
    assert not any(measure(at_rest, config, rng).increments.any() for _ in range(50))
