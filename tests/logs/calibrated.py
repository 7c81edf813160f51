"""A log of a simulated robot whose odometry and laser are off by known values."""

import math

import numpy as np
from shapely.geometry import LineString

from mecp_env.core.se2 import between, chained, composed
from mecp_env.logs.log import Log
from mecp_env.logs.odometry_model import OdometryModel, measured
from mecp_env.world.config import LaserConfig
from mecp_env.world.laser import Laser
from mecp_env.world.layout import load_layout
from mecp_env.world.outline import Outline, build_outline

STEP_M, TURN_RAD, CLEAR_M = 0.15, 0.25, 0.35


def simulated_log(model: OdometryModel, x_m: float = 0.08, scans: int = 1000, seed: int = 0) -> Log:
    """A drive through the office; the odometry errs as the model says, and the log does not say where the laser is."""
    rng, outline = np.random.default_rng(seed), build_outline(load_layout("office"))
    laser = LaserConfig(sweeps=1, beams=181, field_of_view_deg=180.0, range_sigma_m=0.02, max_range_m=20.0, x_m=x_m)
    true = wandering(outline, scans, rng)
    taken = [Laser(outline, laser).scan(pose, rng) for pose in true]
    ranges = np.array([np.where(scan.hit[0], scan.ranges[0], np.nan) for scan in taken])
    noisy = chained(measured(with_noise(between(true[:-1], true[1:]), model, rng), model.correction))
    return Log("simulated", 0.4 * np.arange(scans), ranges, taken[0].bearings[0], 20.0, np.zeros(3), noisy, true)


def wandering(outline: Outline, scans: int, rng: np.random.Generator) -> np.ndarray:
    """(n,3) poses from one random place to the next that can be seen, turning while driving."""
    area = outline.free_area.buffer(-CLEAR_M)
    low, high = np.reshape(area.bounds, (2, 2))
    poses, goal = [np.array(outline.starts[0], float)], None
    while len(poses) < scans:
        x, y, heading = poses[-1]
        while goal is None or math.dist(goal, (x, y)) < STEP_M:
            tried = rng.uniform(low, high)
            goal = tried if area.contains(LineString([(x, y), tried])) else goal
        turn = math.remainder(math.atan2(goal[1] - y, goal[0] - x) - heading, 2.0 * math.pi)
        turn = min(max(turn, -TURN_RAD), TURN_RAD)
        ahead = STEP_M * (abs(turn) < 0.5 * TURN_RAD)
        poses.append(composed(poses[-1], np.array([ahead * math.cos(turn / 2), ahead * math.sin(turn / 2), turn])))
        if not area.contains(LineString([(x, y), poses[-1][:2] + 1e-6])):
            goal, poses[-1] = None, composed(poses[-2], np.array([0.0, 0.0, TURN_RAD]))
    return np.array(poses)


def with_noise(motion: np.ndarray, model: OdometryModel, rng: np.random.Generator) -> np.ndarray:
    """(n,3) motions of arcs (n,3), whose distance and turn have the noise of the model."""
    distance, turn = np.hypot(motion[:, 0], motion[:, 1]), motion[:, 2]
    sigmas = np.array([model.sigmas(d, w) for d, w in zip(distance, abs(turn), strict=True)])
    distance, turn = np.stack((distance, turn)) + sigmas.T * rng.standard_normal((2, len(motion)))
    return np.stack((distance * np.cos(0.5 * turn), distance * np.sin(0.5 * turn), turn), axis=1)
