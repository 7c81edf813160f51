"""OpenKarto as a rival of `real`: scan matching in a correlation grid, a graph of poses, and its sparse optimum.

The package `yag_slam` (extra `lab`) has Karto's scan matcher and loop search, and the solver of K. Konolige, G.
Grisetti, R. Kuemmerle, W. Burgard, B. Limketkai and R. Vincent, "Efficient sparse pose adjustment for 2D mapping", IROS
2010. It runs with its own settings, on the scans that the estimator used, with the odometry as the log has it.
"""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from benchmarks.common import Figures
from mecp_env.core.carriers import Array, Ints
from mecp_env.evaluation.trajectory import coincident, relation_error, trajectory_error
from mecp_env.logs.log import Log

PACKAGE = "yag_slam"
RANGE_SHARE = 0.9  # of the laser's range, up to which the package trusts a beam where it reads logs itself
LEAST_RANGE_M = 0.05


def figures(log: Log, rows: Ints, T_odom_robot: Array) -> Figures:
    """The errors of both paths by the names that `real` has for those of the estimator, and what the run cost.

    On the scans `rows` (n,) of a log, whose laser is at the robot's centre, with odometry (n,3).
    """
    paths, scored = run(log, rows, T_odom_robot)
    for prefix, T_map_robot in paths.items():
        if log.T_ref_robot is not None:
            error = trajectory_error(T_map_robot, log.T_ref_robot[rows])
            scored |= {f"{prefix}ate_m": error.rmse_m, f"{prefix}ate_deg": math.degrees(error.rmse_rad)}
        both = {"relations": log.relations, "relations_at_scans": coincident(log.t, log.relations)}
        for name, relations in both.items():
            if len(relations):
                of = relation_error(log.t[rows], T_map_robot, relations)
                scored |= {f"{prefix}{name}_m": of.mean_m, f"{prefix}{name}_deg": math.degrees(of.mean_rad)}
    return scored


def run(log: Log, rows: Ints, T_odom_robot: Array) -> tuple[dict[str, Array], Figures]:
    """The poses (n,3) when each scan was processed and after the last optimum of the graph; time and closed loops."""
    from yag_slam.graph_slam import GraphSlam
    from yag_slam.models import LocalizedRangeScan
    from yag_slam.scan_matching import Scan2DMatcherCpp

    slam, online, loops = GraphSlam(Scan2DMatcherCpp({}), Scan2DMatcherCpp({}, loop=True)), [], 0
    view = float(log.bearings[0]), float(log.bearings[-1]), log.step_rad
    limits = LEAST_RANGE_M, log.max_range_m, RANGE_SHARE * log.max_range_m
    start = time.thread_time()
    for row, T_odom in zip(rows.tolist(), T_odom_robot.tolist(), strict=True):
        # a beam without a return lies beyond what the package trusts
        ranges = np.nan_to_num(log.ranges[row], nan=log.max_range_m + 1.0).tolist()
        scan = LocalizedRangeScan(ranges, *view, *limits, *T_odom)
        _, closed = slam.process_scan(scan)
        online.append(_pose(scan.corrected_pose))
        loops += bool(closed)
    slam.run_opt()
    spent = time.thread_time() - start
    final = [_pose(vertex.obj.corrected_pose) for vertex in slam.graph.vertices]
    cost = {"karto_ms_per_scan_mean": 1e3 * spent / len(rows), "karto_loops": loops}
    return {"karto_": np.array(online), "karto_final_": np.array(final)}, cost


def _pose(transform: Any) -> tuple[float, float, float]:
    return transform.x, transform.y, transform.euler[-1]
