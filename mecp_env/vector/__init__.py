"""Many environments at once: what `gymnasium.make_vec` calls for the ids of this package (docs/vector.md)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium

from mecp_env.core.processes import WorkerDied, WorkerError
from mecp_env.vector.batch import BatchEnv
from mecp_env.vector.checks import check_integer

__all__ = ["BatchEnv", "WorkerDied", "WorkerError", "make_batch"]

OPTIONS = ("workers", "batch_size", "autoreset_mode", "context", "copy")


def make_batch(
    name: str, num_envs: int = 1, *, wrappers: tuple[Callable[[Any], Any], ...] = (), **keywords: Any
) -> BatchEnv:
    """`num_envs` environments of the registered id `name`, each in `wrappers`.

    Keywords named in `OPTIONS` are those of `BatchEnv`; all others go to `gymnasium.make`, `max_episode_steps` and
    `render_mode` too. Raises `ValueError` for another number than 1, 2, ...
    """
    options = {option: keywords.pop(option) for option in OPTIONS if option in keywords}
    return BatchEnv([partial(_make, name, wrappers, keywords)] * check_integer("num_envs", num_envs), **options)


def _make(name: str, wrappers: tuple[Callable[[Any], Any], ...], keywords: dict[str, Any]) -> gymnasium.Env[Any, Any]:
    env = gymnasium.make(f"mecp_env:{name}", **{"disable_env_checker": True} | keywords)
    for wrapper in wrappers:
        env = wrapper(env)
    return env


make_first = partial(make_batch, "mecp_env/First-v0")
make_paper_map = partial(make_batch, "mecp_env/PaperMap-v0")
make = partial(make_batch, "mecp_env/Layout-v0")
make_rooms = partial(make_batch, "mecp_env/Rooms-v0")
make_floor_plan = partial(make_batch, "mecp_env/FloorPlan-v0")
make_active_halls = partial(make_batch, "mecp_env/ActiveHalls-v0")
make_active_corridors = partial(make_batch, "mecp_env/ActiveCorridors-v0")
make_active_cheap_robot = partial(make_batch, "mecp_env/ActiveCheapRobot-v0")
