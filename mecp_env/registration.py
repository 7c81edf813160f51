"""The functions that `gymnasium.make` calls: the environment of a configuration, with the wrapper that its actions
need.
"""

from __future__ import annotations

from typing import Any

import gymnasium

from mecp_env.config import EnvConfig, merge, plain, plain_value, refuse_keywords
from mecp_env.core.errors import ConfigError
from mecp_env.core.warm_up import prepare
from mecp_env.env import MecpEnv
from mecp_env.episode.buildings import GENERATE, KEYWORDS, PLAN, generator_keywords, plan_keywords
from mecp_env.episode.tasks import FIRST, TASKS
from mecp_env.wrappers import GoalActions

PAPER_LAYOUT = "paper"


def make(
    config: EnvConfig | dict[str, Any] | None = None, render_mode: str | None = None, **keywords: Any
) -> gymnasium.Env[Any, Any]:
    """`Layout-v0`: the building of `layout`; the environment is in `GoalActions` where `actions="goal"`."""
    prepare()
    env = MecpEnv(config, render_mode, **keywords)
    return GoalActions(env) if env.config.actions == "goal" else env


def make_paper_map(
    config: EnvConfig | dict[str, Any] | None = None, render_mode: str | None = None, **keywords: Any
) -> gymnasium.Env[Any, Any]:
    """`PaperMap-v0`: the building of the paper, nine rooms. As `make`; raises `ConfigError` for another layout."""
    layout = merge(plain(config), keywords).get("layout", PAPER_LAYOUT)
    if layout != PAPER_LAYOUT:
        raise ConfigError(f"layout: {layout!r:.80}, PaperMap-v0 is {PAPER_LAYOUT!r}; Layout-v0 takes any")
    return make(config, render_mode, **keywords | {"layout": PAPER_LAYOUT})


def make_rooms(
    config: EnvConfig | dict[str, Any] | None = None, render_mode: str | None = None, **keywords: Any
) -> gymnasium.Env[Any, Any]:
    """`Rooms-v0`: a new generated building at every reset; as `make`.

    Keywords are the fields of `EnvConfig`, `difficulty` ("medium"), `split` ("train") and every field of
    `GeneratorSpec`, which overrides the difficulty. Raises `ConfigError`, also for a layout.
    """
    buildings, rest = generator_keywords(keywords)
    return _make_from(GENERATE, buildings, config, render_mode, rest)


def make_first(config: Any = None, render_mode: str | None = None, **keywords: Any) -> gymnasium.Env[Any, Any]:
    """`First-v0`: small buildings, five motions, one vector to observe, 500 steps; as `make_rooms`."""
    return make_rooms(None, render_mode, **over(FIRST, config, keywords))


def make_task(name: str, config: Any, render_mode: str | None, keywords: dict[str, Any]) -> gymnasium.Env[Any, Any]:
    """A task of active SLAM: as `make_rooms`, with the fields of the task below those given."""
    return make_rooms(None, render_mode, **over(TASKS[name], config, keywords))


def over(fields: dict[str, Any], config: Any, keywords: dict[str, Any]) -> dict[str, Any]:
    """The fields of a task, overridden by a configuration, and both by keywords."""
    return merge(merge(fields, plain(config)), {name: plain_value(value) for name, value in keywords.items()})


def make_floor_plan(
    config: EnvConfig | dict[str, Any] | None = None, render_mode: str | None = None, **keywords: Any
) -> gymnasium.Env[Any, Any]:
    """`FloorPlan-v0`: a real floor plan, or one drawn from a folder at every reset; as `make`.

    Keywords are the fields of `EnvConfig`, `plan` (the path of a file, or of a folder with its subfolders; images are
    used if `resolution_m` is given), and the options of `load_plan`. Raises `ConfigError`, also for a layout, and
    `LayoutError` for an unreadable plan.
    """
    plans, rest = plan_keywords(keywords)
    return _make_from(PLAN, plans, config, render_mode, rest)


def _make_from(
    key: str, fields: dict[str, Any], config: Any, render_mode: str | None, keywords: dict[str, Any]
) -> gymnasium.Env[Any, Any]:
    """As `make`, with the layout `{key: ...}` of a configuration, `fields` over it."""
    refuse_keywords(keywords, KEYWORDS[key], "Rooms-v0" if key == GENERATE else "FloorPlan-v0")
    layout = merge(plain(config), keywords).get("layout", {key: {}})
    if not isinstance(layout, dict) or key not in layout:
        raise ConfigError(f"layout: {layout!r:.80}, this environment makes its own; Layout-v0 takes any")
    return make(config, render_mode, **keywords | {"layout": layout | {key: layout[key] | fields}})


def make_active_halls(config: Any = None, render_mode: str | None = None, **keywords: Any) -> gymnasium.Env[Any, Any]:
    """`ActiveHalls-v0`: large rooms, a short-range laser, wheels that slip."""
    return make_task("ActiveHalls-v0", config, render_mode, keywords)


def make_active_corridors(
    config: Any = None, render_mode: str | None = None, **keywords: Any
) -> gymnasium.Env[Any, Any]:
    """`ActiveCorridors-v0`: rooms that look alike, a laser that sees ahead only, wheels that slip."""
    return make_task("ActiveCorridors-v0", config, render_mode, keywords)


def make_active_cheap_robot(
    config: Any = None, render_mode: str | None = None, **keywords: Any
) -> gymnasium.Env[Any, Any]:
    """`ActiveCheapRobot-v0`: furnished rooms, noisy beams, wheels that slip."""
    return make_task("ActiveCheapRobot-v0", config, render_mode, keywords)


MAKERS: tuple[Any, ...] = (
    make_first,
    *(make, make_paper_map, make_rooms, make_floor_plan),
    *(make_active_halls, make_active_corridors, make_active_cheap_robot),
)
for _maker in MAKERS:
    _maker.metadata = MecpEnv.metadata  # gymnasium.make reads the render modes from it
