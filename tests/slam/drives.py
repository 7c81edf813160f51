"""Scripted drives through an included layout: sensor data and true poses."""

import math
from collections import Counter, defaultdict
from dataclasses import dataclass

import numpy as np

from mecp_env.core.se2 import compose, inverse, wrap_angle
from mecp_env.evaluation.ground_truth import true_correspondences
from mecp_env.slam.config import SlamConfig
from mecp_env.slam.messages import Reason
from mecp_env.slam.pipeline import SlamPipeline
from mecp_env.slam.protocols import Associator
from mecp_env.world.config import LaserConfig, OdometryConfig, RobotConfig
from mecp_env.world.laser import Laser
from mecp_env.world.layout import load_layout
from mecp_env.world.odometry import measure
from mecp_env.world.outline import build_outline
from mecp_env.world.simulation import Simulation

THROUGH_THE_DOOR = ((2.0, 1.8), (4.2, 1.8), (6.0, 1.8), (7.5, 3.5), (7.5, 1.5), (5.8, 1.8), (4.0, 1.8), (2.5, 4.0))


class Given(Associator):
    """An associator that answers as a function does."""

    def __init__(self, answer):
        self.associate = answer


def fed(pipeline, drive, first=0, last=None):
    """The SLAM output of each scan of a drive, which are given to a pipeline one by one."""
    for odometry, scan in zip(drive.odometry[first:last], drive.scans[first:last], strict=True):
        yield pipeline.start(scan) if odometry is None else pipeline.step(odometry, scan)


@dataclass
class Drive:
    outline: object
    odometry: list
    scans: list
    T_world_robot: list

    def run(self, config: SlamConfig):
        """The SLAM output and the true corner of each corner, scan by scan."""
        pipeline = SlamPipeline(config)
        for output, pose in zip(fed(pipeline, self), self.T_world_robot, strict=True):
            T_world_laser = compose(pose, config.sensor.T_robot_laser)
            true = true_correspondences(T_world_laser, self.outline)(output.corners)
            yield pipeline, output, true, self._error(output, pose)

    def in_map(self, T_world):
        """A pose of the world in the frame of the map, which is that of the first scan's robot."""
        return compose(inverse(self.T_world_robot[0]), T_world)

    @property
    def T_map_robot(self):
        return [self.in_map(pose) for pose in self.T_world_robot]

    def _error(self, output, pose):
        error = self.in_map(pose) - output.belief.T_map_robot
        error[2] = wrap_angle(error[2])
        return error


def scripted_drive(layout="two_rooms", waypoints=THROUGH_THE_DOOR, sweeps=4, seed=0, **laser_fields) -> Drive:
    """Straight from waypoint to waypoint (world frame), three scans at rest first."""
    outline, rng = build_outline(load_layout(layout)), np.random.default_rng(seed)
    simulation = Simulation(outline, RobotConfig())
    laser = Laser(outline, LaserConfig(sweeps=sweeps, **laser_fields))
    simulation.reset(np.array(outline.starts[0], float))
    drive = Drive(outline, [], [], [])
    for _ in range(3):
        _keep(drive, None, laser.scan(simulation.T_world_robot, rng), simulation.T_world_robot)
    for waypoint in waypoints:
        while math.dist(waypoint, simulation.T_world_robot[:2]) > 0.3:
            motion = simulation.step(*_towards(waypoint, simulation.T_world_robot))
            odometry = measure(motion, OdometryConfig(), rng)
            _keep(drive, odometry, laser.scan(simulation.T_world_robot, rng), simulation.T_world_robot)
    return drive


def _towards(waypoint, pose):
    turn = wrap_angle(math.atan2(waypoint[1] - pose[1], waypoint[0] - pose[0]) - pose[2])
    return 0.6 * max(0.0, math.cos(turn)) ** 3, max(-1.2, min(1.2, 1.5 * turn))


def _keep(drive, odometry, scan, pose):
    drive.odometry.append(odometry)
    drive.scans.append(scan)
    drive.T_world_robot.append(pose)


def majority_identity(steps):
    """The true corner of each landmark of a run: that of most of its sightings."""
    votes = defaultdict(Counter)
    for _, output, truth, _ in steps:
        for feature, corner in zip(output.match.ids.tolist(), truth.tolist(), strict=True):
            votes[feature][corner] += 1
    return {feature: count.most_common(1)[0][0] for feature, count in votes.items()}


def share_right(steps, reasons=tuple(Reason)):
    """The share of the corners recognised for these reasons that are the landmark's own, and how many there are."""
    identity = majority_identity(steps)
    right = [
        identity[int(output.match.ids[i])] == true[i] >= 0
        for _, output, true, _ in steps
        for i in output.match.recognised()
        if output.match.reason[i] in reasons
    ]
    return np.mean(right), len(right)
