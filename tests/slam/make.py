"""Builders of the carriers between the stages: a test states what matters to it, and the rest has a default."""

import math
from typing import Any

import numpy as np

from mecp_env.core.sensors import Odometry, Scan
from mecp_env.slam.association.cliques import Headings
from mecp_env.slam.association.mecp import OPEN, PolygonTest
from mecp_env.slam.frontend.beams import RolledScan
from mecp_env.slam.frontend.line_corners import EndBearing
from mecp_env.slam.grid.canvas import NOTHING
from mecp_env.slam.grid.cells import Raster
from mecp_env.slam.localisation import Agreement, Evidence
from mecp_env.slam.localisation.relocalisation import Hypothesis, Located
from mecp_env.slam.mecp.polygons import EdgeBeams
from mecp_env.slam.messages import (
    FEATURE,
    NO_ID,
    UNKNOWN_ROOM,
    Belief,
    Candidate,
    Clusters,
    CornerKind,
    Corners,
    Decision,
    Door,
    Doorways,
    FeatureTable,
    MapPolygon,
    MapView,
    Match,
    MergedScan,
    Polygon,
    PolygonGroup,
    RoomGraph,
    Segments,
    SemanticGrid,
    Sighting,
)
from mecp_env.slam.output import SlamOutput
from mecp_env.slam.panorama.registration import Registration

MAX_RANGE_M = 30.0


def column(values: Any, shape: tuple[int, ...], dtype: Any = np.float64) -> Any:
    """An array of this shape of its own; one value stands for all rows."""
    return np.broadcast_to(np.asarray(values, dtype), shape).copy()


def integers(values: Any) -> Any:
    return np.array(values, np.int64).reshape(-1)


def square(value: Any, n: int) -> Any:
    """(n,n), with `value` on the diagonal where it is a number."""
    return value * np.eye(n) if np.ndim(value) == 0 else np.array(value, float)


def blocks(value: Any, n: int) -> Any:
    """(n,2,2), with `value` on the diagonals where it is a number or one of each (n,)."""
    value = np.asarray(value, float)
    return value.copy() if value.ndim == 3 else column(value, (n,))[:, None, None] * np.eye(2)


def slopes(function: Any, at: Any) -> Any:
    """(...,n) derivatives by each of the n numbers of an array, by central differences."""
    steps = 1e-6 * np.eye(np.size(at)).reshape(-1, *np.shape(at))
    return np.stack([(function(at + step) - function(at - step)) / 2e-6 for step in steps], axis=-1)


def polar(points: Any) -> Any:
    """(n,2) range and bearing of points (n,2)."""
    points = np.asarray(points, float).reshape(-1, 2)
    return np.column_stack([np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0])])


def nominal_bearings(sweeps: int = 4, beams: int = 720) -> Any:
    """(K,B) as the laser has them: ascending in each sweep in (-pi, pi]."""
    step = 2.0 * math.pi / (sweeps * beams)
    return (-math.pi + step * np.arange(1, sweeps * beams + 1)).reshape(beams, sweeps).T.copy()


MIDDLES: Any = (np.arange(720) + 0.5) * math.pi / 360.0 - math.pi  # rad, of 720 beams, none of which points ahead


def scan(ranges: Any, bearings: Any = None, hit: Any = None, max_range_m: float = MAX_RANGE_M) -> Scan:
    """A burst (K,B); what is nearer than `max_range_m` is hit."""
    ranges = np.asarray(ranges, float)
    hit = column(ranges < max_range_m if hit is None else hit, ranges.shape, np.bool_)
    bearings = nominal_bearings(*ranges.shape) if bearings is None else bearings
    return Scan(np.where(hit, ranges, max_range_m), bearings, hit, max_range_m)


def odometry(increments: Any = ((0.0, 0.0),), sigmas: Any = (0.0, 0.0), cov: Any = None, bumper: bool = False) -> Any:
    """Arcs (M,2) with these standard deviations, or with `cov`."""
    increments = np.array(increments, float).reshape(-1, 2)
    cov = np.square(sigmas) * np.eye(2) if cov is None else cov
    return Odometry(increments, column(cov, (len(increments), 2, 2)), bumper)


def beams(ranges: Any, bearings: Any = None, hit: Any = None) -> MergedScan:
    """Beams (B,) with one raw beam behind each; what is nearer than `MAX_RANGE_M` is hit."""
    ranges = np.array(ranges, float)
    bearings = nominal_bearings(1, len(ranges))[0] if bearings is None else bearings
    hit = column(ranges < MAX_RANGE_M if hit is None else hit, ranges.shape, np.bool_)
    return MergedScan(ranges, bearings, hit, column(1, ranges.shape, np.int64), MAX_RANGE_M, ranges, bearings)


def clusters(first: Any, last: Any, kind: Any = 0, roll: int = 0) -> Clusters:
    return Clusters(roll, integers(first), integers(last), column(kind, np.shape(first), np.int64))


def segments(
    points: Any = None, line: Any = 0.0, first: Any = (), last: Any = (), roll: int = 0, cov: Any = 0.0
) -> Segments:
    n = len(first) if points is None else len(points)
    ends = column(0.0 if points is None else points, (n, 2, 2)), column(line, (n, 2)), column(cov, (n, 2, 2))
    return Segments(*ends, np.arange(n), integers(first), integers(last), roll)


def doorways(jambs: Any = (), confirmable: Any = True) -> Doorways:
    """Gaps of 0.9 m between pairs of corners (g,2)."""
    jambs = integers(jambs).reshape(-1, 2)
    return Doorways(jambs, np.full(len(jambs), 0.9), column(confirmable, (len(jambs),), np.bool_))


def corners(z: Any = (), *, points: Any = None, cov: Any = 1e-4, gaps: Doorways | None = None, **marks: Any) -> Corners:
    """Corners at ranges and bearings `z` (n,2), or at `points` (n,2) m of the robot's frame.

    `marks` are kind, convex, normals, beyond and sites; by default they are outer corners of one room.
    """
    z = np.array(z, float).reshape(-1, 2) if points is None else polar(points)
    of: dict[str, Any] = {
        "kind": CornerKind.CROSSING,
        "convex": True,
        "normals": 0.0,
        "beyond": -1,
        "sites": True,
    } | marks
    n, types = len(z), (np.int64, np.bool_, np.float64, np.int64, np.bool_)
    columns = {
        name: column(values, (n, 2) if name == "normals" else (n,), dtype)
        for (name, values), dtype in zip(of.items(), types, strict=True)
    }
    return Corners(z, square(cov, 2 * n), doorways=gaps or doorways(), **columns)


def edges(*labels: Any) -> Any:
    """(m,4) the intervals of a polygon, one over each whole edge."""
    return np.array([[edge, 0.0, 1.0, label] for edge, label in enumerate(labels)], float).reshape(-1, 4)


def polygon(vertices: Any, intervals: Any = None) -> Polygon:
    return Polygon(integers(vertices), edges() if intervals is None else np.array(intervals, float))


def map_polygon(ids: Any, room: int = 0, intervals: Any = None) -> MapPolygon:
    return MapPolygon(integers(ids), edges() if intervals is None else np.array(intervals, float), room)


def features(n: int = 0, **columns: Any) -> FeatureTable:
    """`n` features; what is not given is 0."""
    table = FeatureTable(np.zeros(n, FEATURE))
    for name, values in columns.items():
        table.rows[name] = values
    return table


def belief(
    pose: Any = (0.0, 0.0, 0.0), p_map: Any = (), ids: Any = None, *, pose_cov: Any = 1e-6, covs: Any = 1e-4
) -> Belief:
    """A pose and landmarks at `p_map` (N,2); covariances are full, or variances."""
    p_map = np.array(p_map, float).reshape(-1, 2)
    n = len(p_map)
    ids = np.arange(n) if ids is None else integers(ids)
    return Belief(np.array(pose, float), square(pose_cov, 3), ids, p_map, blocks(covs, n))


def match(ids: Any, decision: Any = None, *, reason: Any = 0, nis: Any = math.nan, polygon: int = -1) -> Match:
    """Corners that are the landmarks `ids` (n,); those with NO_ID are new."""
    ids = integers(ids)
    decision = np.where(ids == NO_ID, int(Decision.NEW), int(Decision.LANDMARK)) if decision is None else decision
    reasons = column(reason, ids.shape, np.int64), column(nis, ids.shape)
    return Match(ids, column(decision, ids.shape, np.int64), *reasons, polygon, polygon)


def sighting(corners: Corners, match: Match, seen_from: Belief, step: int = 0, through: Any = -1) -> Sighting:
    return Sighting(corners, match, column(through, (len(corners),), np.int64), seen_from, step)


def door(
    id: int = 0, jambs: Any = (0, 1), other_face: Any = None, rooms: Any = (0, UNKNOWN_ROOM), sightings: int = 3
) -> Door:
    return Door(id, jambs, other_face, rooms, sightings)


def candidate(ends: Any = ((0.0, 0.0), (0.0, 0.0)), room: int = 0, ids: Any = (NO_ID, NO_ID)) -> Candidate:
    return Candidate(np.array(ends, float), ids, room, 1, 1)


def graph(current: int = 0, rooms: Any = (0,), **fields: Any) -> RoomGraph:
    """One room, without doors."""
    given: dict[str, Any] = {"in_doorway": False, "doors": (), "candidates": (), "merged": {}} | fields
    return RoomGraph(current=current, rooms=rooms, **given)


def view(belief: Belief, features: FeatureTable, corners: Corners, graph: RoomGraph, polygons: Any = ((),)) -> MapView:
    """A map with polygons (C,k) of these ids; by default without any."""
    ids = np.array(polygons, np.int64)
    groups = {ids.shape[1]: PolygonGroup(np.arange(len(ids)), ids)} if ids.size else {}
    return MapView(1, belief, features, groups, graph, np.full(len(corners), -1))


def polygon_test(gate: float = OPEN) -> PolygonTest:
    """A joint test, and this gate of each vertex and of the centre."""
    return PolygonTest(gate, gate, iterate=True)


def grid(
    label: Any,
    room: Any = 0,
    polygon: Any = False,
    *,
    origin: Any = (0.0, 0.0),
    resolution_m: float = 0.1,
    version: int = 1,
) -> SemanticGrid:
    label = np.array(label, np.uint8)
    layers = column(polygon, label.shape, np.bool_), column(room, label.shape, np.int16)
    return SemanticGrid(label, *layers, np.array(origin, float), resolution_m, version)


def output(**fields: Any) -> SlamOutput:
    """What a step saw and decided; a test sets the fields that are read."""
    names = "beams", "segments", "corners", "associated", "match", "belief", "graph", "grid"
    given: dict[str, Any] = dict.fromkeys(names) | {"step": 1, "polygons": (), "map_polygons": (), "diverged": False}
    return SlamOutput(**(given | fields))


def edge_beams(ranges: Any, wall: Any = True) -> EdgeBeams:
    """720 beams as the edge of a polygon is compared with them."""
    return EdgeBeams(column(ranges, (720,)), MIDDLES, column(wall, (720,), np.bool_), math.pi / 360.0)


def evidence(
    share: float,
    recognised: float,
    sharp: bool = True,
    *,
    explained: float | None = None,
    least: float = 0.65,
    **marks: Any,
) -> Evidence:
    """What beams and corners say of a pose: these shares of them agree with the map."""
    return Evidence(Agreement(share, share if explained is None else explained, least), recognised, sharp, **marks)


def hypothesis(
    ids: Any,
    at: Any = (0.0, 0.0, 0.0),
    *,
    share: float = 1.0,
    explained: float = 0.9,
    recognised: float = 1.0,
    near: bool = False,
) -> Hypothesis:
    """A pose for which as many corners speak, which are these landmarks."""
    located = Located(np.array(at), np.eye(3), np.arange(len(ids)), integers(ids))
    return Hypothesis(located, share, explained, recognised, near)


def registration(turn: float, paired: int, against: int = 0, x: float = 0.0) -> Registration:
    """A precise one of a scan that was taken where the past one was, or at `x` ahead of it."""
    return Registration(np.array([x, 0.0, turn]), 1e6 * np.eye(3), np.arange(paired), against)


def raster(height: int, width: int, lattice: Any) -> Raster:
    """For painting on (height, width) cells, of which nothing is marked."""
    return Raster(np.zeros((height, width + 1), np.uint8), lattice, np.array(NOTHING), 0.1)


def rolled_scan(polar: Any, hit: Any, ranges: Any, bearings: Any, step: float, max_range_m: float) -> RolledScan:
    """Beams in order of bearing, from the first one on."""
    return RolledScan(polar, hit, ranges, bearings, 0, step, max_range_m)


def end_bearing(bearing: float, variance: float = 1e-4) -> EndBearing:
    """The bearing of a line end behind which nothing speaks for a second face."""
    return EndBearing(bearing, variance, 0.0)


def headings(mean: float, sigma: float, descriptor_rad: float) -> Headings:
    return Headings(mean, sigma**2, descriptor_rad)
