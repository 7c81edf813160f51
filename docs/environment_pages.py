"""A page and a film per environment id, from the registry, the docstrings and the fields of the configuration."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import gymnasium
import numpy as np
from field_tables import Row, code, comments, configuration_page, field_rows, table
from gymnasium import spaces

import mecp_env
from mecp_env.config import EnvConfig, ObservationConfig, RewardConfig
from mecp_env.env import MecpEnv
from mecp_env.episode.observation_arrays import COLUMNS
from mecp_env.episode.rewards import weights_of
from mecp_env.episode.tasks import TASKS
from mecp_env.floorplans import PlanOptions
from mecp_env.policies.explorers import Nearest
from mecp_env.render.screen import Film
from mecp_env.world import library
from mecp_env.world.config import DIFFICULTIES, GeneratorSpec

GIVEN = {"FloorPlan-v0": {"plan": str(Path(*library.__path__) / "office.json")}}  # arguments without a default
FILM_GOALS = 12


def write(folder: Path) -> None:
    """Write the pages and films of all ids, and the page of the configuration."""
    folder.mkdir(exist_ok=True)
    (folder / "configuration.md").write_text(configuration_page())
    for name in mecp_env.ENVIRONMENTS:
        (folder / f"{short(name)}.md").write_text(page(name))
        film(name).save(folder / f"{short(name)}.gif")


def short(name: str) -> str:
    """`Rooms-v0` of `mecp_env/Rooms-v0`."""
    return name.partition("/")[2]


def make(name: str, **keywords: Any) -> gymnasium.Env[Any, Any]:
    """The environment of an id."""
    return gymnasium.make(name, **GIVEN.get(short(name), {}), **keywords)


def page(name: str) -> str:
    """The page of an id."""
    env, switches = make(name), ObservationConfig.model_fields.items()
    everything = {"format": "dict"} | {switch: True for switch, field in switches if field.annotation is bool}
    config: EnvConfig = env.get_wrapper_attr("config")
    uncertain = {"format": "dict", "uncertainty": config.observation.uncertainty}
    plan = ', plan="home.json"' if short(name) in GIVEN else ""
    return "\n\n".join(
        [
            f"# {short(name)}",
            f"![The explorer nearest: ground truth and estimate]({short(name)}.gif)",
            maker_text(name) + task_text(name),
            f'```python\nimport gymnasium as gym\nimport mecp_env\n\nenv = gym.make("{name}"{plan})\n```',
            doc_section("Description"),
            doc_section("Action Space"),
            f'Without `actions`, this environment has `actions="{config.actions}"`: `{env.action_space}`.',
            "## Observation Space",
            f'Without `observation`, this environment has `observation="{config.observation.format}"`.',
            'The format "dict" is a `Dict`. Values beyond their bounds are clipped; `info["saturated"]` counts them.',
            *observation_tables(*(make(name, observation=seen).observation_space for seen in (everything, uncertain))),
            "### Other formats",
            "[observations.md](../observations.md) describes their columns and channels.",
            format_table(name),
            "## Rewards",
            "The sum of these terms, each also in `info`; [rewards.md](../rewards.md) contains the formulas.",
            reward_table(config),
            doc_section("Starting State"),
            doc_section("Episode End"),
            doc_section("Arguments"),
            "[configuration.md](configuration.md) lists all fields. This environment sets:",
            settings_table(config),
            *building_tables(config),
            doc_section("Vectorized environment"),
            doc_section("Version History"),
        ]
    )


def maker_text(name: str) -> str:
    """The docstring of the entry point, without the id that it starts with."""
    module, _, maker = mecp_env.ENVIRONMENTS[name].partition(":")
    text = (inspect.getdoc(getattr(importlib.import_module(module), maker)) or "").partition(": ")[2]
    return text[:1].upper() + text[1:]


def task_text(name: str) -> str:
    """Where the reader finds more about a task of active SLAM; nothing for other ids."""
    more = " [tasks.md](../tasks.md) describes the tasks of active SLAM: goals on known ground, reward, results."
    return more if short(name) in TASKS else ""


def doc_section(title: str) -> str:
    """A section of the docstring of `MecpEnv`, with its title."""
    text = inspect.getdoc(MecpEnv) or ""
    return f"## {title}\n" + text.partition(f"## {title}\n")[2].partition("\n## ")[0]


def observation_tables(whole: spaces.Space[Any], default: spaces.Space[Any]) -> Iterator[str]:
    """Per array its shape and columns; `whole` also has what is left out by default."""
    assert isinstance(whole, spaces.Dict)
    assert isinstance(default, spaces.Dict)
    for key, box in whole.spaces.items():
        shown = default.spaces.get(key, box)
        asked = "" if key in default.spaces else f', with `observation={{"{key}": True}}`'
        yield f"### {key}"
        yield f"`{shown.shape}` {box.dtype}{asked}"
        yield table(("index", "content", "unit", "bounds"), list(column_rows(key, box, shown)))


def column_rows(key: str, box: spaces.Space[Any], shown: spaces.Space[Any]) -> Iterator[Row]:
    """Index, content, unit and bounds of the columns of an array; of an image, of its layers."""
    assert isinstance(box, spaces.Box)
    assert isinstance(shown, spaces.Box)
    axis = 0 if box.dtype == np.uint8 else -1
    for i, (name, unit, _) in enumerate(COLUMNS[key]):
        low, high = np.take(box.low, i, axis).min(), np.take(box.high, i, axis).max()
        asked = "" if i < shown.shape[axis] else ', with `observation={"uncertainty": True}`'
        index = str(i) if len(COLUMNS[key]) > 1 else "all"
        yield index, name + asked, unit, f"[{low:g},\u00a0{high:g}]"


def format_table(name: str) -> str:
    """The spaces of the formats beside "dict"."""
    formats = [word for word in get_args(ObservationConfig.model_fields["format"].annotation) if word != "dict"]
    spaces_of = {word: make(name, observation=word).observation_space for word in formats}
    return table(("argument", "space"), [(f'`observation="{k}"`', f"`{v}`") for k, v in spaces_of.items()])


def reward_table(config: EnvConfig) -> str:
    """The terms with their weights."""
    meaning = comments(RewardConfig)
    rows = [(f"`reward_{term}`", f"{weight:g}", meaning[term]) for term, weight in weights_of(config.reward).items()]
    return table(("term", "weight", "unit and meaning"), rows)


def settings_table(config: EnvConfig) -> str:
    """The fields in which an environment differs from `EnvConfig`."""
    usual = dict(leaves(EnvConfig().to_dict()))
    rows = [(f"`{name}`", code(value)) for name, value in leaves(config.to_dict()) if usual.get(name) != value]
    return table(("field", "value"), [row for row in rows if "library" not in row[1]])


def building_tables(config: EnvConfig) -> Iterator[str]:
    """The keywords of generated buildings or floor plans."""
    if "generate" in config.layout:
        yield "Keywords of generated buildings, `split`, `difficulty` and what it sets:"
        yield table(("field", "default", *DIFFICULTIES, "meaning"), list(generator_rows()))
    elif "plan" in config.layout:
        yield "Keywords of floor plans, beside `plan` and `kind`:"
        yield table(("field", "default", "meaning"), list(field_rows(PlanOptions)))


def generator_rows() -> Iterator[Row]:
    """The fields of `GeneratorSpec`, with the values of the difficulties."""
    for name, default, meaning in field_rows(GeneratorSpec):
        values = [preset.get(name.strip("`")) for preset in DIFFICULTIES.values()]
        yield name, default, *("" if value is None else code(value) for value in values), meaning


def leaves(tree: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """The values of a configuration, with their dotted names."""
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def film(name: str) -> Film:
    """The first drives of the explorer `nearest`."""
    env, shots = make(name, actions="goal", observation="dict", render_mode="rgb_array"), Film(most_frames=60)
    env.set_wrapper_attr("callback", lambda step: shots.offer(step[4]["period"], env.render))
    explore(env)
    return shots


def explore(env: gymnasium.Env[Any, Any]) -> float:
    """Drive to the nearest goal a few times; the metres driven."""
    policy, (observation, info), over = Nearest(), env.reset(seed=0), False
    for _ in range(FILM_GOALS):
        if not over:
            observation, _, terminated, truncated, info = env.step(policy.act(observation))
            over = terminated or truncated
    return float(info["metres"])
