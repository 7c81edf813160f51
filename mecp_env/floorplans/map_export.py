"""An estimated map for other programs: landmarks as CSV, rooms and doors as GeoJSON, a graph for g2o."""

from __future__ import annotations

import csv
import json
import os
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely.geometry import LineString, MultiPoint, mapping
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient

from mecp_env.slam.messages import Belief, Door, RoomGraph, SemanticGrid

COLUMNS = ("id", "x_m", "y_m", "var_x_m2", "cov_xy_m2", "var_y_m2")
HALF_THICK_M = 0.05  # of the outline of a door of which one face is known


def save_landmarks(belief: Belief, path: str | os.PathLike[str]) -> None:
    """Write a line per landmark: id, position in the map frame (m), and its marginal covariance (m2)."""
    with Path(path).open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(COLUMNS)
        for i, (x, y), cov in zip(belief.ids.tolist(), belief.p_map.tolist(), belief.covs.tolist(), strict=True):
            rows.writerow((i, x, y, cov[0][0], cov[0][1], cov[1][1]))


def save_g2o(belief: Belief, path: str | os.PathLike[str]) -> None:
    """Write the pose as vertex 0 and each landmark as vertex id + 1, with an edge to it from the pose.

    The information of an edge is the inverse of the landmark's marginal covariance, in the robot's frame.
    """
    x, y, heading = belief.T_map_robot.tolist()
    cos, sin = np.cos(heading), np.sin(heading)
    R_robot_map = np.array([(cos, sin), (-sin, cos)])
    lines = [f"VERTEX_SE2 0 {x!r} {y!r} {heading!r}", "FIX 0"]
    for i, p_map, cov in zip(belief.ids.tolist(), belief.p_map, belief.covs, strict=True):
        px, py = (R_robot_map @ (p_map - belief.T_map_robot[:2])).tolist()
        (a, b), (_, c) = np.linalg.inv(R_robot_map @ cov @ R_robot_map.T).tolist()
        lines += [f"VERTEX_XY {i + 1} {p_map.item(0)!r} {p_map.item(1)!r}"]
        lines += [f"EDGE_SE2_XY 0 {i + 1} {px!r} {py!r} {a!r} {b!r} {c!r}"]
    Path(path).write_text("\n".join([*lines, ""]), encoding="utf-8")


def save_rooms(belief: Belief, graph: RoomGraph, grid: SemanticGrid, path: str | os.PathLike[str]) -> None:
    """Write rooms and doors as outlines with ids, as GeoJSON (RFC 7946) with coordinates in metres of the map frame."""
    rooms = [_feature("room", room, _room(grid, room), {}) for room in graph.rooms if (grid.room == room).any()]
    doors = [_feature("door", d.id, _door(belief, d), {"rooms": [r for r in d.rooms if r >= 0]}) for d in graph.doors]
    document = {"type": "FeatureCollection", "features": [*rooms, *doors]}
    Path(path).write_text(json.dumps(document, allow_nan=False), encoding="utf-8")


def _feature(kind: str, number: int, outline: BaseGeometry, more: dict[str, Any]) -> dict[str, Any]:
    properties = {"kind": kind, "id": number, **more}
    return {"type": "Feature", "id": f"{kind}-{number}", "properties": properties, "geometry": mapping(outline)}


def _room(grid: SemanticGrid, room: int) -> BaseGeometry:
    """The outline of a room's cells, each ring as the right-hand rule wants it."""
    runs = []
    for row, cells in enumerate(grid.room == room):
        ends = np.flatnonzero(np.diff(cells, prepend=False, append=False)).tolist()
        runs += [(first, row, last, row + 1) for first, last in list(pairwise(ends))[::2]]
    boxes = np.array(runs, np.float64) * grid.resolution_m + np.tile(grid.origin, 2)
    union = shapely.union_all(shapely.box(*boxes.T))
    parts = [orient(part, 1.0) for part in shapely.get_parts(union)]
    return parts[0] if len(parts) == 1 else shapely.MultiPolygon(parts)


def _door(belief: Belief, door: Door) -> BaseGeometry:
    """The outline between the jambs of both faces; of one face, a strip along it."""
    ids = np.array([*door.jambs, *(door.other_face or ())])
    corners = belief.p_map[belief.rows(ids)]
    hull = MultiPoint(corners).convex_hull if len(ids) > 2 else LineString(corners)
    flat = hull.geom_type != "Polygon"
    return orient(hull.buffer(HALF_THICK_M, cap_style="flat") if flat else hull, 1.0)
