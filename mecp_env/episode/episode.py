"""One episode: everything that persists over its steps, and the format of its snapshot.

The shapes of the arrays of a running episode beside those of the estimator (`mecp_env.slam.map_file`).
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mecp_env.config import EnvConfig
from mecp_env.core.carriers import Array
from mecp_env.core.snapshot import StateError, damage_refused
from mecp_env.core.snapshot_check import (
    FAR,
    LONG,
    NEAR,
    Shapes,
    check_declared,
    check_fields,
    check_shapes,
    examples_of,
)
from mecp_env.episode.observations import TravelledPath
from mecp_env.episode.rewards import RewardMemory
from mecp_env.evaluation.metrics import EpisodeMetrics
from mecp_env.planning.goal_list import INTEGERS, LENGTHS
from mecp_env.planning.goals import GoalHistory, Goals
from mecp_env.slam.map_file import SHAPES as SLAM_SHAPES
from mecp_env.slam.map_file import check_pipeline
from mecp_env.slam.messages import Match
from mecp_env.slam.output import SlamOutput
from mecp_env.slam.pipeline import SlamPipeline
from mecp_env.world.moving_obstacles import Moving

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


STATE_FORMAT, STATE_VERSION = "mecp_env/state", 20
RECENT = 0.2  # weight of the last scan in the recent share of recognised corners
PARTS = ("simulation", "moving", "episode")  # of a state, encoded


@dataclass(slots=True, eq=False)
class EpisodeState:
    """Everything that persists over the steps of an episode except the body and the random numbers; plain state."""

    pipeline: SlamPipeline
    slam_output: SlamOutput
    metrics: EpisodeMetrics
    goal_history: GoalHistory = field(default_factory=GoalHistory)
    goals: Goals = field(default_factory=Goals)
    offered: Goals | None = None  # the goals, known ground and waiting, where these are offered
    goals_step: int = -1  # step of the last search for goals
    goals_key: tuple[int, ...] = ()  # of the map in that search
    memory: RewardMemory = field(default_factory=RewardMemory)
    path_map: TravelledPath = field(default_factory=TravelledPath)
    path_world: TravelledPath = field(default_factory=TravelledPath)
    target: Array | None = None  # (2,) m, map frame: where a goal action drives to
    recognised: float = 0.0  # recent share of the corners of a scan that were matched to landmarks
    quiet: int = 0  # steps without a goal, in a row
    contact: bool = False
    saturated: int = 0  # clipped values and omitted rows of the observation
    over: bool = False

    @property
    def rows(self) -> Goals:
        """The rows of the observation's goals."""
        return self.goals if self.offered is None else self.offered

    def note_recognised(self, match: Match) -> None:
        """Follow the share of corners that are matched; a scan without corners has none."""
        share = match.found / max(1, len(match.ids))
        self.recognised += RECENT * (share - self.recognised)


def goals_key(output: SlamOutput) -> tuple[int, ...]:
    """A value that changes whenever other goals may be found."""
    graph = output.graph
    return output.grid.version, graph.current, len(graph.doors), len(graph.candidates), len(graph.merged)


def nearest_goal(goals: Goals, target: Array | None) -> int:
    """Row of the goal at `target` (2,) m, or -1 if it is no longer a goal."""
    if target is None or not len(goals):
        return -1
    far = np.hypot(*(goals.p_map - target).T)
    return int(far.argmin()) if far.min() < 0.5 else -1


def check_state(state: Any, config: EnvConfig) -> None:
    """Raise `StateError` unless `state` has this format, version and configuration."""
    if not isinstance(state, dict) or state.get("format") != STATE_FORMAT:
        raise StateError(f"state: expected what get_state() gave, given {type(state).__name__}")
    if state.get("version") != STATE_VERSION:
        raise StateError(f"state.version: {state.get('version')!r}, this is version {STATE_VERSION}")
    missing = {"config", "building", "random", "seed", *PARTS} - set(state)
    if missing:
        raise StateError(f"state: without {', '.join(sorted(missing))}")
    if state["config"] != config.to_json():
        raise StateError(
            f"state.config: the state is of an environment with another configuration{_other(state, config)}"
        )


def _other(state: dict[str, Any], config: EnvConfig) -> str:
    """The sections and fields in which the configuration of a state differs, as the end of a sentence."""
    try:
        given, own = json.loads(state["config"]), json.loads(config.to_json())
        names = sorted(name for name in own.keys() | given.keys() if given.get(name) != own.get(name))
    except (TypeError, ValueError, AttributeError):
        return ""
    return f": {', '.join(names)!s:.200}" * bool(names)


def check_parts(seed: Any, body: Any, moving: Any, episode: Any, fresh: SlamPipeline) -> None:
    """Raise `StateError` unless the parts of a state are of their types; `fresh` is a pipeline just made."""
    examples = examples_of(fresh)
    with damage_refused():
        check_fields(seed, int | None, "state.seed", examples)
        check_fields(body, dict[str, Array], "state.simulation", examples)
        check_fields(moving, Moving, "state.moving", examples)
        check_fields(episode, EpisodeState, "state.episode", examples)
