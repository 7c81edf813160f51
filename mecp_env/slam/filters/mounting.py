"""A laser that is not at the robot's centre: inside the pipeline, the pose of the filter is that of the laser.

Scans are taken by the laser, so every stage works in its frame and none needs the mounting pose. The odometry measures
the robot: each prediction moves the pose to the robot's centre, predicts, and moves it back; `SlamOutput.belief` has
the pose of the robot's centre again. A centred laser costs nothing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mecp_env.core.carriers import Array
from mecp_env.core.se2 import compose, inverse
from mecp_env.core.sensors import LaserView, Odometry
from mecp_env.slam.messages import Belief
from mecp_env.slam.protocols import Filter


def mount(landmark_filter: Filter, view: LaserView) -> None:
    """Turn the pose of a new filter, that of the robot at the start, into that of its laser."""
    if not view.is_centred:
        landmark_filter.shift_pose(view.T_robot_laser)


def predict_mounted(landmark_filter: Filter, odometry: Odometry, view: LaserView) -> None:
    """Move the laser by the motion of the robot that it is mounted on."""
    if view.is_centred:
        landmark_filter.predict(odometry)
        return
    landmark_filter.shift_pose(inverse(view.T_robot_laser))
    landmark_filter.predict(odometry)
    landmark_filter.shift_pose(view.T_robot_laser)


def robot_belief(belief: Belief, view: LaserView) -> Belief:
    """The belief with the pose of the robot's centre in place of the laser's."""
    if view.is_centred:
        return belief
    T_map_robot, pose_cov = _at_robot(belief.T_map_robot, belief.pose_cov, view)
    return replace(belief, T_map_robot=T_map_robot, pose_cov=pose_cov)


def robot_joint(landmark_filter: Filter, view: LaserView) -> tuple[Array, Array]:
    """Mean (3+2N,) of the robot's centre and all landmarks, and its covariance, in world coordinates; copies."""
    mean, cov = landmark_filter.marginal(landmark_filter.ids)
    T_map_robot, cov = _at_robot(mean[:3], cov, view)
    return np.concatenate([T_map_robot, mean[3:]]), cov


def _at_robot(T_map_laser: Array, cov: Array, view: LaserView) -> tuple[Array, Array]:
    """The pose of the robot's centre, and the covariance of which that of the pose is the first three rows."""
    T_map_robot, cov = compose(T_map_laser, inverse(view.T_robot_laser)), cov.copy()
    x, y = T_map_robot[:2] - T_map_laser[:2]
    for row, by_heading in enumerate((-y, x)):  # F P F^T, F = [[1, 0, -y], [0, 1, x], [0, 0, 1]]
        cov[row] += by_heading * cov[2]
    for column, by_heading in enumerate((-y, x)):
        cov[:, column] += by_heading * cov[:, 2]
    return T_map_robot, cov
