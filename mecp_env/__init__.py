"""Active SLAM indoors: Gymnasium environments with EKF-SLAM and MECP data association inside.

Importing this package registers the environments and does nothing else: numba, scipy, pymunk, pygame and matplotlib are
loaded by the first `gymnasium.make`.
"""

from __future__ import annotations

from mecp_env.core.interrupts import watch_interrupts

watch_interrupts()  # before the imports: Ctrl-C may come while they run

from importlib import import_module  # noqa: E402
from typing import Any  # noqa: E402

from gymnasium.envs.registration import register, registry  # noqa: E402

from mecp_env.core.version import __version__ as __version__  # noqa: E402

ENVIRONMENTS = {  # id -> entry point
    "mecp_env/First-v0": "mecp_env.registration:make_first",
    "mecp_env/PaperMap-v0": "mecp_env.registration:make_paper_map",
    "mecp_env/Layout-v0": "mecp_env.registration:make",
    "mecp_env/Rooms-v0": "mecp_env.registration:make_rooms",
    "mecp_env/FloorPlan-v0": "mecp_env.registration:make_floor_plan",
    "mecp_env/ActiveHalls-v0": "mecp_env.registration:make_active_halls",
    "mecp_env/ActiveCorridors-v0": "mecp_env.registration:make_active_corridors",
    "mecp_env/ActiveCheapRobot-v0": "mecp_env.registration:make_active_cheap_robot",
}


def register_environments() -> None:
    """Register the ids of `ENVIRONMENTS`; a second call changes nothing."""
    for name, entry_point in ENVIRONMENTS.items():
        if name not in registry:
            batch = entry_point.replace("registration", "vector")
            register(id=name, entry_point=entry_point, vector_entry_point=batch)


def flat_names(env: Any = None, *, actions: str = "velocity", uncertainty: bool = False) -> tuple[str, ...]:
    """The name of each number of an observation of the format "flat", in its order (docs/observations.md).

    Of an environment that was made with `observation="flat"`, or of one with these `actions` ("velocity", "discrete",
    "goal") and `uncertainty`. Raises `ConfigError` for another environment, and for unknown actions.
    """
    layout = import_module("mecp_env.episode.flat_layout")  # by name, as an entry point: loaded when it is called
    names: tuple[str, ...] = layout.flat_names(env, actions=actions, uncertainty=uncertainty)
    return names


register_environments()
