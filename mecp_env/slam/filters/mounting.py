"""A laser that is not at the robot's centre: inside the pipeline, the pose of the filter is that of the laser.

Scans are taken by the laser, so every stage works in its frame and none needs the mounting pose. The odometry measures
the robot: each prediction moves the pose to the robot's centre, predicts, and moves it back; `SlamOutput.belief` has
the pose of the robot's centre again. A centred laser costs nothing.
"""

from __future__ import annotations

from dataclasses import replace

from mecp_env.core.laser_view import LaserView
from mecp_env.core.messages import Odometry
from mecp_env.core.se2 import compose, inverse
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
    T_map_robot, pose_cov = compose(belief.T_map_robot, inverse(view.T_robot_laser)), belief.pose_cov.copy()
    x, y = T_map_robot[:2] - belief.T_map_robot[:2]
    for row, by_heading in enumerate((-y, x)):  # F P F^T, F = [[1, 0, -y], [0, 1, x], [0, 0, 1]]
        pose_cov[row] += by_heading * pose_cov[2]
    for column, by_heading in enumerate((-y, x)):
        pose_cov[:, column] += by_heading * pose_cov[:, 2]
    return replace(belief, T_map_robot=T_map_robot, pose_cov=pose_cov)
