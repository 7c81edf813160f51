"""A drive through two rooms with the simulator's laser and odometry, as an archive."""

from pathlib import Path

import numpy as np

from mecp_env.core.se2 import chained
from mecp_env.logs.odometry_model import end_of
from tests.slam.drives import scripted_drive


def write_simulated(path: Path, seed: int = 0, **laser: object) -> Path:
    view = {"field_of_view_deg": 360.0, "beams": 720, "max_range_m": 30.0, "x_m": 0.0}  # an archive has no mounting
    drive = scripted_drive("two_rooms", preset="lms200", sweeps=1, seed=seed, **view | laser)
    scans, readings = drive.scans[2:], drive.odometry[3:]  # the first three are at rest
    np.savez_compressed(
        path,
        t=0.4 * np.arange(len(scans)),
        ranges=[np.where(scan.hit[0], scan.ranges[0], np.nan) for scan in scans],
        angles=scans[0].bearings[0],
        odo=chained(np.array([end_of(reading.increments) for reading in readings])),
        ref=np.array(drive.T_world_robot[2:]),
        max_range_m=30.3,  # readings from 99 % on are no return
    )
    return path
