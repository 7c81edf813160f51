"""Where policies are compared: the buildings, the robot, and what is changed in the environment."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from mecp_env.config import merge
from mecp_env.core.errors import ConfigError
from mecp_env.core.files import exists
from mecp_env.core.provenance import checksum
from mecp_env.episode.buildings import PLAN, PlanFiles, generator_keywords, make_source
from mecp_env.episode.tasks import TASKS
from mecp_env.floorplans.map_server import image_of

ADDED = ("layout", "plans", "content", "env")  # fields that results of older versions do not have


@dataclass(frozen=True, slots=True)
class Setting:
    """Where policies are compared; the same for all of them.

    With a `layout`, episode i takes plan i mod `plans`, and its start and noise from the seed i.
    """

    difficulty: str = "medium"  # of the generated buildings; without a meaning for a task
    split: str = "test"
    estimator: str = "slam"
    max_steps: int = 3000
    task: str = ""  # a task of active SLAM, such as ActiveHalls-v0, in place of a difficulty
    layout: str | dict[str, Any] = ""  # as in `EnvConfig`, in place of generated buildings: a name, or plans
    plans: int = 0  # buildings of the layout; 0: generated ones
    content: str = ""  # a name, or the checksum of the plans
    env: dict[str, Any] = field(default_factory=dict)  # fields of `EnvConfig` that are changed

    @property
    def name(self) -> str:
        """That of the task, or the difficulty."""
        return self.task or self.difficulty

    @property
    def where(self) -> str:
        """The buildings and what is changed, in words."""
        buildings = f"{self.name}, split {self.split}"
        if self.layout:
            buildings = f"{self.place}{f', robot of {self.task}' if self.task else ''}"
        return ", ".join([buildings, *words_of(self.env)])

    @property
    def place(self) -> str:
        """The name of the layout, or the path of the plans."""
        return self.layout if isinstance(self.layout, str) else str(self.layout[PLAN]["path"])

    def buildings(self, episode: int = 0) -> dict[str, Any]:
        """The keywords of `gymnasium.make` that select the buildings; with a layout, that of an episode alone."""
        if isinstance(self.layout, dict):
            source = source_of_plans(json.dumps(self.layout), self.content)
            return {"id": "mecp_env/Layout-v0", "layout": source.layout(episode % self.plans)}
        if self.layout:
            return {"id": "mecp_env/Layout-v0", "layout": self.layout}
        generated = {} if self.task else {"difficulty": self.difficulty}
        return {"id": f"mecp_env/{self.task or 'Rooms-v0'}", "split": self.split, **generated}

    def fields(self, policy_fields: Mapping[str, Any]) -> dict[str, Any]:
        """The other keywords: the robot of a task below what the policy needs, and both below what is changed."""
        robot = generator_keywords(TASKS[self.task])[1] if self.layout and self.task else {}
        fields = merge(merge({**robot, "start": "random"}, dict(policy_fields)), self.env)
        return fields | {"estimator": self.estimator, "max_steps": self.max_steps}

    def building(self, episode: int) -> int:
        """The number of the building of an episode in its environment."""
        return 0 if self.layout else episode

    def named(self) -> dict[str, Any]:
        """The fields as JSON data; those that older versions did not have only where they are set."""
        return {name: value for name, value in asdict(self).items() if value or name not in ADDED}

    def run_key(self) -> dict[str, Any]:
        """What the episodes in a folder have in common: all but the estimator and the path of the plans.

        The path may differ between machines; `content` compares the files.
        """
        key = {name: value for name, value in self.named().items() if name != "estimator"}
        if isinstance(self.layout, dict):
            key["layout"] = {name: value for name, value in self.layout[PLAN].items() if name != "path"}
        return key


def words_of(fields: Mapping[str, Any], path: str = "") -> list[str]:
    """`["laser.max_range_m 4.0"]` for `{"laser": {"max_range_m": 4.0}}`."""
    words = []
    for name, value in fields.items():
        inner = f"{path}{name}"
        words += words_of(value, f"{inner}.") if isinstance(value, Mapping) else [f"{inner} {value}"]
    return words


def plan_fields(path: Path, reading: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a `Setting` for the plans in a folder and below, or a single one, read with those options.

    Raises `ConfigError` for a path without plans, `LayoutError` for one that leads out of the folder.
    """
    if not exists(path):
        raise ConfigError(f"plans: {path}: no such file or folder")
    layout = {PLAN: {"path": str(path), **reading}}
    files = plan_source(layout).paths
    return {"layout": layout, "plans": len(files), "content": checksum_of(files, path)}


@lru_cache(maxsize=1)
def source_of_plans(layout: str, content: str) -> PlanFiles:
    """The plans of a layout (as JSON), which stay read. Raises `ConfigError` where their files are no longer those."""
    given = json.loads(layout)
    source = plan_source(given)
    if content != checksum_of(source.paths, Path(given[PLAN]["path"])):
        raise ConfigError(f"plans: {given[PLAN]['path']}: files have changed since the evaluation started")
    return source


def plan_source(layout: Mapping[str, Any]) -> PlanFiles:
    """The plans of a layout, in the order of their numbers."""
    source = make_source(layout)
    assert isinstance(source, PlanFiles)
    return source


def plan_names(setting: Setting) -> list[str]:
    """The files of the plans of a setting below their folder, in the order of their numbers; none without plans."""
    if isinstance(setting.layout, str):
        return []
    place = Path(setting.place)
    return [str(path.relative_to(place)) if path != place else path.name for path in plan_source(setting.layout).paths]


def checksum_of(files: tuple[Path, ...], folder: Path) -> str:
    """Of the names of plans and their content, with the images that yaml files name."""
    parts = []
    for path in files:
        image = image_of(path) if path.suffix.lower() in (".yaml", ".yml") else None
        data = [source.read_bytes() for source in (path, image) if source is not None and exists(source)]
        parts.append(f"{path.relative_to(folder)} {checksum(b''.join(data))}")
    return checksum("\n".join(parts).encode())
