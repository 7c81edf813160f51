"""The first task, and the tasks of active SLAM: buildings and robots in which greedy exploration loses its map.

Plain fields of the buildings and of `EnvConfig`; settings were chosen on the validation split.
"""

from __future__ import annotations

from typing import Any

from mecp_env.core.errors import ConfigError
from mecp_env.core.settings import guess

FIRST: dict[str, Any] = {  # of `First-v0`: a stock learner with a small network learns it in minutes
    "difficulty": "easy",
    "actions": "discrete",
    "observation": {"format": "flat"},
    "max_steps": 500,
    "start": "random",
}
ACTIVE: dict[str, Any] = {  # of every task
    "actions": "goal",
    "start": "random",
    "max_steps": 1500,
    "planning": {"known_ground": {"places": 8, "wait_steps": 5}},
    "observation": {"uncertainty": True},
    "reward": {"preset": "correct_coverage"},
    "slam": {"panorama": {"use": "blind"}},  # where the robot drives decides what it recognises (docs/tasks.md)
}
PLAIN: dict[str, Any] = {"shaped_rooms": 0, "furniture": 0.0, "corridors": 0}
TASKS: dict[str, dict[str, Any]] = {
    # large rooms in loops with a few pillars and boxes, a scanner that sees 2.5 m, wheels that slip
    "ActiveHalls-v0": {
        **ACTIVE,
        **PLAIN,
        "rooms": 6,
        "room_side_m": (5.5, 7.5),
        "loops": 2,
        "furniture": 0.5,
        "pieces": ("square_pillar", "box"),
        "laser": {"max_range_m": 2.5},
        "odometry": {"preset": "skid_steer"},
    },
    # rooms that look alike along corridors, a scanner that looks ahead only, wheels that slip
    "ActiveCorridors-v0": {
        **ACTIVE,
        **PLAIN,
        "rooms": 12,
        "room_side_m": (3.6, 3.6),
        "corridors": 3,
        "loops": 2,
        "laser": {"preset": "lms200", "max_range_m": 3.0},
        "odometry": {"preset": "skid_steer"},
    },
    # a cheap robot in furnished rooms: noisy beams up to 3 m, wheels that slip
    "ActiveCheapRobot-v0": {
        **ACTIVE,
        "rooms": 8,
        "room_side_m": (3.2, 5.5),
        "corridors": 1,
        "loops": 1,
        "shaped_rooms": 1,
        "furniture": 1.0,
        "laser": {"preset": "rplidar_a1", "max_range_m": 3.0},
        "odometry": {"preset": "skid_steer"},
    },
}


def task_fields(name: Any) -> dict[str, Any]:
    """The fields of a task. Raises `ConfigError` for an unknown one, with those there are."""
    if name not in TASKS:
        raise ConfigError(f"task: {name!r:.80}, expected one of {', '.join(TASKS)}{guess(name, TASKS)}")
    return TASKS[name]
