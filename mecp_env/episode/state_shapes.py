"""The shapes of the arrays of a running episode beside those of the estimator (`mecp_env.slam.state_shapes`)."""

from __future__ import annotations

from typing import Any

from mecp_env.core.snapshot import StateError
from mecp_env.core.snapshot_shapes import FAR, LONG, NEAR, Shapes, check_declared, check_shapes
from mecp_env.planning.goal_list import INTEGERS, LENGTHS
from mecp_env.slam.state_shapes import SHAPES as SLAM_SHAPES
from mecp_env.slam.state_shapes import check_pipeline

SHAPES: Shapes = {
    **SLAM_SHAPES,
    "EpisodeState": {"target": f"2 in {NEAR}", "quiet": f" in 0:{LONG}"},
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
    "GoalHistory": {"entry[]": "2", "good_place": "2"},
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
        "dark_seed": f" in 0:{LONG}",
    },
}


def check_arrays(body: dict[str, Any], episode: Any, moving: Any) -> None:
    """Raise `StateError` unless the arrays of a state are consistent."""
    sizes = check_pipeline(episode.pipeline, "state.episode.pipeline")
    for name, value in body.items():
        check_declared(value, f"6 in {NEAR}", {}, f"state.simulation.{name}")
    check_shapes(episode, SHAPES, "state.episode", sizes)
    check_shapes(moving, SHAPES, "state.moving", sizes)
    if not moving.can_continue():
        raise StateError("state.moving: a route without the next point, or pedestrians without destinations")


def check_truth(episode: Any, free: tuple[int, ...]) -> None:
    """Raise `StateError` unless the seen cells are those of the building, whose free space has the shape `free`."""
    seen, visited = episode.metrics.seen.shape, episode.metrics.visited_by_obstacles.shape
    if seen != free or visited not in ((0, 0), free):
        raise StateError(f"state.episode.metrics: cells {seen} and {visited}, the building has {free}")
