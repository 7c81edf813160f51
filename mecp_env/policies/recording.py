"""Episodes of a policy as a Minari dataset (docs/datasets.md); the extra `datasets` installs minari."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from mecp_env.config import ObservationConfig, merge
from mecp_env.core.errors import ConfigError
from mecp_env.policies.registry import Policy
from mecp_env.policies.rollout import MASKS, Env, masks_of, options_of, run_policy
from mecp_env.policies.setting import Setting
from mecp_env.wrappers import GoalActions

INSTALL = "install the extra `datasets`: pip install 'mecp_env[datasets]'"
INFOS = ("coverage", "correct_coverage", "pose_error_m", "metres", "period")  # of `info`, kept with each observation


@dataclass(slots=True)
class EpisodeRows:
    """An episode of T actions: observations and infos have T + 1 rows, all others T."""

    seed: int | None
    observations: list[Any]
    infos: list[dict[str, Any]]
    actions: list[Any] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    terminations: list[bool] = field(default_factory=list)
    truncations: list[bool] = field(default_factory=list)


class Recorder(gym.Wrapper[Any, Any, Any, Any]):
    """Keeps the rows of the current episode; with goal actions also the mask of each observation."""

    rows: EpisodeRows

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start the rows of a new episode."""
        observation, info = super().reset(seed=seed, options=options)
        self.rows = EpisodeRows(seed, [observation], [self._kept(info)])
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step, and keep what came of it."""
        observation, reward, terminated, truncated, info = super().step(action)
        self.rows.observations.append(observation)
        self.rows.infos.append(self._kept(info))
        self.rows.actions.append(action)
        self.rows.rewards.append(float(reward))
        self.rows.terminations.append(terminated)
        self.rows.truncations.append(truncated)
        return observation, reward, terminated, truncated, info

    def _kept(self, info: dict[str, Any]) -> dict[str, Any]:
        mask = masks_of(self.env)()
        return {name: info[name] for name in INFOS} | ({} if mask is None else {MASKS: mask})


@dataclass(frozen=True)
class Recording:
    """What is recorded: the policy, in which buildings, what is observed, and which actions are kept."""

    policy: Policy
    setting: Setting
    observation: str = "flat"
    actions: str = ""  # "velocity": every control step of a policy that selects goals; "": the policy's own

    def episodes(self, first: int, count: int) -> Iterator[EpisodeRows]:
        """The rows of episodes in the buildings first, first + 1, ..., which are also their seeds."""
        env, recorder = self.make()
        see = self._view_of_policy(recorder)
        for episode in range(first, first + count):
            run_policy(env, self.policy, lambda _: None, (self.setting.building(episode), episode), see)
            yield recorder.rows
        env.close()

    def make(self) -> tuple[Env, Recorder]:
        """The environment with the actions of the policy, and the recorder in it. Raises `ConfigError`."""
        mine, kept = self.policy.actions, self.actions or self.policy.actions
        if kept != mine and (mine, kept) != ("goal", "velocity"):
            raise ConfigError(f"actions: {kept!r}, expected {mine!r}, the actions of this policy")
        parts = {} if self.observation == "dict" else {"map": False, "scan": False}  # which only tables have
        config = self.setting.fields(options_of(self.policy))
        asked = {"actions": kept, "observation": {"format": self.observation, **parts}}
        env = gym.make(disable_env_checker=True, **self.setting.buildings(), **merge(config, asked))
        recorder = Recorder(env)
        return (recorder if kept == mine else GoalActions(recorder)), recorder

    def _view_of_policy(self, env: Env) -> Callable[[Any], Any]:
        """What the policy sees of an observation that is recorded: the format and the parts that it needs."""
        base: Any = env.unwrapped
        asked = merge({"observation": {}}, options_of(self.policy))["observation"]
        seen = ObservationConfig(**{**base.config.observation.model_dump(), "format": "dict", **asked})
        if seen == base.config.observation:
            return lambda recorded: recorded
        observer = base.observer_of(seen, self.policy.actions)
        return lambda recorded: base.observed_by(observer)


class DatasetWriter:
    """Appends episodes to a new Minari dataset; after each one the dataset is complete.

    `name`: its id, as mecp_env/rooms/bfs-v0. Raises `ConfigError` without minari, for a malformed name, and for a
    dataset that exists.
    """

    def __init__(self, name: str, recording: Recording, algorithm: str) -> None:
        self.name, self.algorithm, self.recording = name, algorithm, recording
        self.dataset: Any = None
        try:
            import h5py  # noqa: F401  (minari imports it only when it writes)
            from minari.dataset.minari_dataset import parse_dataset_id
            from minari.storage.datasets_root_dir import get_dataset_path
        except ModuleNotFoundError as error:
            raise ConfigError(f"datasets: need {error.name}; {INSTALL}") from None
        try:
            parse_dataset_id(name)
        except (ValueError, TypeError):
            raise ConfigError(f"name: {name!r:.80}, expected FOLDER/NAME-vNUMBER of letters, digits, _ and -") from None
        self.path = Path(get_dataset_path(name))
        if self.path.exists():
            raise ConfigError(f"name: {name}: {self.path} exists; choose another name or version, or delete it")

    def add(self, rows: EpisodeRows) -> None:
        """Append an episode."""
        episode = buffer_of(rows)
        if self.dataset is None:
            self.dataset = self._create(episode)
        else:
            self.dataset.update_dataset_from_buffer([episode])

    def _create(self, episode: Any) -> Any:
        import minari

        env, recorder = self.recording.make()
        about = f"{self.algorithm} in {self.recording.setting.where}, by mecp_env"
        with warnings.catch_warnings():
            # authors and links are for the user to add
            warnings.filterwarnings("ignore", ".* is set to None", UserWarning)
            dataset = minari.create_dataset_from_buffers(
                self.name,
                [episode],
                env=recorder.env,
                algorithm_name=self.algorithm,
                description=about,
                requirements=[f"mecp_env=={version('mecp_env')}"],
            )
        env.close()
        return dataset


def buffer_of(rows: EpisodeRows) -> Any:
    """The `EpisodeBuffer` of minari with an array per part."""
    from minari.data_collector import EpisodeBuffer

    parts = {name: stacked(getattr(rows, name)) for name in ("observations", "actions", "infos")}
    return EpisodeBuffer(**{part.name: getattr(rows, part.name) for part in fields(rows)} | parts)


def stacked(rows: list[Any]) -> Any:
    """An array of all rows; of rows that are dicts, an array per name."""
    if isinstance(rows[0], dict):
        return {name: np.stack([row[name] for row in rows]) for name in rows[0]}
    return np.stack(rows)


def default_name(policy: str, recording: Recording) -> str:
    """An id such as mecp_env/rooms-medium/bfs-goal-flat-v0."""
    setting, kept = recording.setting, recording.actions or recording.policy.actions
    place = setting.task.removesuffix("-v0") or f"rooms-{setting.difficulty}"
    words = re.sub(r"[^\w-]+", "-", Path(policy).name)
    return f"mecp_env/{place.lower()}/{words}-{kept}-{recording.observation}-v0"
