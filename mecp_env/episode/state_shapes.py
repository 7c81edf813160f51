"""The shapes of the arrays of a running episode, per class, as `mecp_env.core.snapshot_shapes` reads them.

Capital letters: F features, P polygons of the map.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mecp_env.core.snapshot import StateError
from mecp_env.core.snapshot_shapes import Shapes, check_declared, check_shapes
from mecp_env.planning.goal_list import INTEGERS, LENGTHS
from mecp_env.slam.messages import FEATURE, FeatureState

FAR = 500  # m; a position further away would need a grid that does not fit into memory
NEAR = f"-{FAR}:{FAR}"
LONG = 1_000_000  # m, rad: anything else that is measured

SHAPES: Shapes = {
    "EpisodeState": {"target": f"2 in {NEAR}", "quiet": f" in 0:{LONG}"},
    "Belief": {
        "T_map_robot": f"3 in {NEAR}",
        "pose_cov": "3 3",
        "ids": "n in 0:F",
        "p_map": f"n 2 in {NEAR}",
        "covs": "n 2 2",
    },
    "FeatureTable": {"rows": "F"},
    "MapPolygon": {"ids": "k in 0:F", "intervals": "i 4", "room": " in -1:32768"},
    "PolygonGroup": {"ids": "n k in 0:F", "index": "n in 0:P"},
    "DoorMap": {"ids": "n", "jambs": "n 4 in -1:F"},
    "Trail": {"places": f"n 4 in -{LONG}:{10**15}"},
    "Canvas": {
        "layers": "7 h w",
        "grid.label": "h w",
        "grid.polygon": "h w",
        "grid.room": "h w",
        "grid.origin": "2",
        "lattice": f"2 in -{LONG}:{LONG}",
        "mask": "h w+1 in 0:1",
        "dirty": "4",
    },
    "SemanticGrid": {"label": "h w in 0:8", "polygon": "h w", "room": "h w in -1:32768", "origin": "2"},
    "ScanLayer": {
        "T_map_robot": f"n 3 in {NEAR}",
        "room": "n in -1:32768",
        "step": "n",
        "anchor": "n k in -1:F",
        "p_robot": f"n k 2 in {NEAR}",
        "outline[]": f"n | m 2 in {NEAR}",
        "strips[]": f"n | m 4 2 in {NEAR}",
        "has_room": "n",
    },
    "PaintedPolygon": {"ring": f"k 2 in {NEAR}"},
    "DoorLayer": {"quads": "n 4 2", "middles": "n 2", "lines": "n 2 2"},
    "GridPainter": {"p_landmark": "n 2"},
    "MergedScan": dict.fromkeys(("ranges", "bearings", "hit", "count"), "b")
    | dict.fromkeys(("raw_ranges", "raw_bearings"), "r"),
    "Segments": {"points": "s 2 2", "line": "s 2", "cov": "s 2 2"} | dict.fromkeys(("cluster", "first", "last"), "s"),
    "Corners": {
        "z": "n 2",
        "cov": "2n 2n",
        "kind": "n",
        "convex": "n",
        "normals": "n 2",
        "beyond": "n in -1:n",
        "sites": "n",
        "doorways.jambs": "d 2 in -1:n",
    },
    "Doorways": {"jambs": "d 2", "width": "d", "confirmable": "d"},
    "Candidate": {"ends": "2 2"},
    "Polygon": {"corners": "k", "intervals": "i 4"},
    "Match": {"ids": "n in -2:F", "decision": "n", "reason": "n", "nis": "n"},
    "EpisodeMetrics": {
        "T_world_map": f"3 in {NEAR}",
        "T_map_robot": f"3 in {NEAR}",
        "seen": "h w",
        "swept_from": "2",
    },
    "AssociationLog": {
        "votes": "f g",
        "features": "f 2 in -1:9223372036854775807",
        "counts": "4",
        "rows": "r 4",
        "used": " in 0:r+1",
    },
    "GoalHistory": {"entry[]": "2"},
    "Goals": {"p_map": f"g 2 in {NEAR}"} | dict.fromkeys((*INTEGERS, *LENGTHS), "g"),
    "TravelledPath": {"points": f"c 2 in {NEAR}", "count": " in 0:c+1"},
    "Moving": {
        "pedestrians": f"n 11 in -{LONG}:{LONG}",
        "routes": f"n 96 2 in -{LONG}:{LONG}",
        "legs": "n 2 in 0:97",
        "places": f"p 2 in {NEAR}",
        "rooms": "p",
        "boxes": f"b 6 in -{LONG}:{LONG}",
        "sizes": f"b 2 in 0:{FAR}",
        "closed": "d",
        "start": f"2 in {NEAR}",
    },
}


def check_arrays(body: dict[str, Any], episode: Any, moving: Any) -> None:
    """Raise `StateError` unless the arrays of a state are consistent."""
    rows, polygons = episode.pipeline.map.features.rows, episode.pipeline.map.polygons
    if rows.dtype != FEATURE or rows.ndim != 1:
        raise StateError("state.episode.pipeline.map.features.rows: another kind of rows")
    landmarks = np.flatnonzero(rows["state"] == FeatureState.LANDMARK)
    if not np.isin(landmarks, episode.pipeline.filter.slot_ids).all():
        raise StateError("state.episode.pipeline.map.features.rows: a landmark that is not in the filter")
    if any(group.ids.shape[1:] != (k,) for k, group in polygons.groups.items()):
        raise StateError("state.episode.pipeline.map.polygons.groups: polygons of another number of vertices")
    for name, value in body.items():
        check_declared(value, f"6 in {NEAR}", {}, f"state.simulation.{name}")
    sizes = {"F": len(rows), "P": len(polygons.polygons)}
    check_filter(episode.pipeline.filter, sizes["F"])
    check_shapes(episode, SHAPES, "state.episode", sizes)
    check_shapes(moving, SHAPES, "state.moving", sizes)
    if not moving.can_continue():
        raise StateError("state.moving: a route without the next point, or pedestrians without destinations")


def check_truth(episode: Any, free: tuple[int, ...]) -> None:
    """Raise `StateError` unless the seen cells are those of the building, whose free space has the shape `free`."""
    seen, visited = episode.metrics.seen.shape, episode.metrics.visited_by_obstacles.shape
    if seen != free or visited not in ((0, 0), free):
        raise StateError(f"state.episode.metrics: cells {seen} and {visited}, the building has {free}")


def check_filter(filter_: Any, features: int) -> None:
    """Raise `StateError` unless the filter has a slot per landmark and a row and column per number."""
    ids, state = filter_.slot_ids, filter_.state
    slots = ((len(state) if state.ndim else 0) - 4) // 2
    if state.shape != (4 + 2 * slots, 3 + 2 * slots) or ids.ndim != 1 or not len(ids) <= slots:
        raise StateError(f"state.episode.pipeline.filter: state {state.shape} for slot_ids {ids.shape}")
    if len(set(ids.tolist()) & set(range(features))) < len(ids):
        raise StateError("state.episode.pipeline.filter.slot_ids: expected different ids of features")
    used = 3 + 2 * len(ids)
    if not (np.abs(state[0, :used]).max() < FAR and np.isfinite(state[1 : 1 + used, :used]).all()):
        raise StateError("state.episode.pipeline.filter.state: not finite, or too far away")
