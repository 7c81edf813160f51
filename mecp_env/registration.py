"""What `gymnasium.make` calls: the environment of a configuration, in the wrapper that its actions need."""

from __future__ import annotations

from typing import Any

import gymnasium

from mecp_env.config import EnvConfig, merge, plain, refuse_keywords
from mecp_env.core.errors import ConfigError
from mecp_env.env import MecpEnv
from mecp_env.episode.buildings import GENERATE, KEYWORDS, PLAN, generator_keywords, plan_keywords
from mecp_env.wrappers import GoalActions

PAPER_LAYOUT = "paper"


def make(
    config: EnvConfig | dict[str, Any] | None = None, render_mode: str | None = None, **keywords: Any
) -> gymnasium.Env[Any, Any]:
    """The entry point of `Layout-v0`: the environment of a configuration, in `GoalActions` where `actions="goal"`."""
    env = MecpEnv(config, render_mode, **keywords)
    return GoalActions(env) if env.config.actions == "goal" else env


def make_paper_map(
    config: EnvConfig | dict[str, Any] | None = None, render_mode: str | None = None, **keywords: Any
) -> gymnasium.Env[Any, Any]:
    """The entry point of `PaperMap-v0`: as `make`, in the paper's building. Raises `ConfigError` for another layout."""
    layout = merge(plain(config), keywords).get("layout", PAPER_LAYOUT)
    if layout != PAPER_LAYOUT:
        raise ConfigError(f"layout: {layout!r:.80}, PaperMap-v0 is {PAPER_LAYOUT!r}; Layout-v0 takes any")
    return make(config, render_mode, **keywords | {"layout": PAPER_LAYOUT})


def make_rooms(
    config: EnvConfig | dict[str, Any] | None = None, render_mode: str | None = None, **keywords: Any
) -> gymnasium.Env[Any, Any]:
    """The entry point of `Rooms-v0`: as `make`, in a building that is generated anew at every reset.

    Beside the fields of `EnvConfig`, keywords are `difficulty` ("medium"), `split` ("train") and every field of
    `GeneratorSpec` over the difficulty's own. Raises `ConfigError`, for a layout too.
    """
    buildings, rest = generator_keywords(keywords)
    return _make_from(GENERATE, buildings, config, render_mode, rest)


def make_floor_plan(
    config: EnvConfig | dict[str, Any] | None = None, render_mode: str | None = None, **keywords: Any
) -> gymnasium.Env[Any, Any]:
    """The entry point of `FloorPlan-v0`: as `make`, in a real floor plan; of a folder, in one drawn at every reset.

    Beside the fields of `EnvConfig`, keywords are `plan`, the path of a file or of a folder (with those in it; images
    are taken where `resolution_m` is given), and the options of `load_plan`. Raises `ConfigError`, for a layout too,
    and `LayoutError` for a plan that cannot be read.
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


for entry_point in (make, make_paper_map, make_rooms, make_floor_plan):  # gymnasium.make asks it for the render modes
    entry_point.metadata = MecpEnv.metadata  # type: ignore[attr-defined]
