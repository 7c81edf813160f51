"""The functions that `gymnasium.make` calls: the environment of a configuration, with the wrapper that its actions
need.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import gymnasium

from mecp_env.config import EnvConfig, merge, plain, plain_value, refuse_keywords
from mecp_env.core.errors import ConfigError
from mecp_env.core.warm_up import prepare
from mecp_env.env import MecpEnv
from mecp_env.episode.buildings import GENERATE, KEYWORDS, PLAN, keywords_of
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
    return _make_from(GENERATE, "Rooms-v0", config, render_mode, keywords)


def make_task(
    fields: dict[str, Any],
    config: EnvConfig | dict[str, Any] | None = None,
    render_mode: str | None = None,
    **keywords: Any,
) -> gymnasium.Env[Any, Any]:
    """As `make_rooms`, with the fields of a task below those given."""
    given = {name: plain_value(value) for name, value in keywords.items()}
    return make_rooms(None, render_mode, **merge(merge(fields, plain(config)), given))


def make_floor_plan(
    config: EnvConfig | dict[str, Any] | None = None, render_mode: str | None = None, **keywords: Any
) -> gymnasium.Env[Any, Any]:
    """`FloorPlan-v0`: a real floor plan, or one drawn from a folder at every reset; as `make`.

    Keywords are the fields of `EnvConfig`, `plan` (the path of a file, or of a folder with its subfolders; images are
    used if `resolution_m` is given), and the options of `load_plan`. Raises `ConfigError`, also for a layout, and
    `LayoutError` for an unreadable plan.
    """
    return _make_from(PLAN, "FloorPlan-v0", config, render_mode, keywords)


def _make_from(
    key: str, name: str, config: Any, render_mode: str | None, keywords: dict[str, Any]
) -> gymnasium.Env[Any, Any]:
    """As `make`, with the layout `{key: ...}` of a configuration, the keywords of its buildings over it."""
    buildings, rest = keywords_of(key, keywords)
    refuse_keywords(rest, KEYWORDS[key], name)
    layout = merge(plain(config), rest).get("layout", {key: {}})
    if not isinstance(layout, dict) or key not in layout:
        raise ConfigError(f"layout: {layout!r:.80}, this environment makes its own; Layout-v0 takes any")
    return make(config, render_mode, **rest | {"layout": layout | {key: layout[key] | buildings}})


make_first = partial(make_task, FIRST)
make_active_halls = partial(make_task, TASKS["ActiveHalls-v0"])
make_active_corridors = partial(make_task, TASKS["ActiveCorridors-v0"])
make_active_cheap_robot = partial(make_task, TASKS["ActiveCheapRobot-v0"])

MAKERS: tuple[Any, ...] = (
    *(make_first, make, make_paper_map, make_rooms, make_floor_plan),
    *(make_active_halls, make_active_corridors, make_active_cheap_robot),
)
for _maker in MAKERS:
    _maker.metadata = MecpEnv.metadata  # gymnasium.make reads the render modes from it
