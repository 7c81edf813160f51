"""Policies compared in the same buildings, from the same start poses.

Everything is measured in metres and simulated time, so that every machine gives the same result.

All policies side by side in the same building, from the same start, in the same simulated time.
"""

from __future__ import annotations

import csv
import json
import platform
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from mecp_env.core.carriers import Bytes
from mecp_env.core.errors import ConfigError
from mecp_env.core.files import write_atomic
from mecp_env.core.intervals import BUDGET_M_PER_M2, Figures
from mecp_env.core.provenance import checksums, dependencies
from mecp_env.core.work_units import WHOLE, FailedUnit, KeptResults, Shard, run_kept
from mecp_env.policies.comparison import Row, compare, returns_of, rows_of, seeds_of, timing
from mecp_env.policies.registry import Policy, make_policy, policy_checksum, source_of
from mecp_env.policies.rollout import EpisodeResult, EpisodeTask, Info, make_rooms, run_episode, run_policy, try_action
from mecp_env.policies.setting import Setting, plan_names
from mecp_env.render.film import Film
from mecp_env.render.screen import thumbnail

PANEL = (320, 290)  # px
ACROSS = 3  # panels in a row
MOST_FRAMES, EVERY = 64, 4  # of a policy, and steps between the first of them
LONGEST = 900  # steps: longer episodes are cut
FIRST = 0, 0  # building and seed


def write_film(policies: Sequence[str], setting: Setting, path: Path, trust: bool = False) -> None:
    """Write the film of all policies in one building as a GIF; long episodes are cut."""
    shorter = replace(setting, max_steps=min(setting.max_steps, LONGEST))
    films = [record(policy, shorter, trust) for policy in policies]
    every = max(film.every for film in films)
    last = max(film.every * (len(film.frames) - 1) for film in films)
    whole = Film()
    for step in range(0, last + every, every):  # an episode that is over stays at its last picture
        whole.frames.append(mosaic([film.frames[min(-(-step // film.every), len(film.frames) - 1)] for film in films]))
    whole.save(path)


def record(policy: str, setting: Setting, trust: bool = False) -> Film:
    """What the robot believes at every n-th step of an exploration, and at its end, with time, metres and coverage."""
    made, film = make_policy(policy, trust), Film(MOST_FRAMES, EVERY)
    env = make_rooms(setting, made)
    period_s = env.get_wrapper_attr("config").robot.period_s

    def picture(info: Info, ended: str = "") -> Bytes:
        """The belief below time, metres and coverage."""
        words = f"{period_s * info['period']:.0f} s    {info['metres']:.0f} m    {info['coverage']:.0%} seen{ended}"
        return thumbnail(env.get_wrapper_attr("view")(), PANEL, policy, words)

    end = run_policy(env, made, lambda info: film.offer(info["period"], lambda: picture(info)), FIRST)
    film.frames.append(picture(end.info, "    ..." if end.info["goals"] else "    done"))
    env.close()
    return film


def mosaic(pictures: list[Bytes]) -> Bytes:
    """The pictures in rows of three; missing ones have the colour of their border."""
    across = min(ACROSS, len(pictures))
    filled = pictures + [np.full_like(pictures[0], pictures[0][0, 0])] * (-len(pictures) % across)
    return np.vstack([np.hstack(filled[i : i + across]) for i in range(0, len(filled), across)])


@dataclass(slots=True, eq=False)
class Evaluation:
    """The policies, where they are compared, and the episodes that are finished."""

    policies: tuple[str, ...]
    setting: Setting
    episodes: int  # buildings, one episode in each
    known_pose: bool = True  # each policy once more with the ground-truth pose
    known_correspondences: bool = False  # and once more with known correspondences
    reference: str = "nearest"  # the policy to which the others are compared
    trust: bool = False  # load model files that may run arbitrary code
    shard: Shard = WHOLE  # of the buildings
    results: list[EpisodeResult] = field(default_factory=list)
    failures: list[FailedUnit] = field(default_factory=list)
    interrupted: bool = False

    @property
    def settings(self) -> list[Setting]:
        """One per estimator."""
        wanted = {"known": self.known_correspondences, "truth": self.known_pose}
        others = [name for name, on in wanted.items() if on and name != self.setting.estimator]
        return [self.setting, *(replace(self.setting, estimator=name) for name in others)]

    def tasks(self) -> list[EpisodeTask]:
        """All episodes, building by building: after an interruption, the finished ones can be compared."""
        checksums = {name: policy_checksum(name) for name in self.policies}
        return [
            EpisodeTask(name, building, setting, self.trust, checksum, source_of(name))
            for building in self.shard.part(range(self.episodes))
            for setting in self.settings
            for name, checksum in checksums.items()
        ]

    def kept(self, folder: Path) -> KeptResults:
        """The finished episodes in a folder. Raises `ConfigError` for those of other code or another setting."""
        return KeptResults(folder, EpisodeResult, {**self.setting.run_key(), **dependencies(), **checksums()})

    def run(self, kept: KeptResults, jobs: int, cluster: str = "") -> Generator[EpisodeResult | FailedUnit]:
        """Each episode: first those that are kept already, then the others as they are finished (see `run_kept`)."""
        tasks = {task.name: task for task in self.tasks()}
        with closing(run_kept(run_episode, tasks, kept, jobs, cluster)) as finished:
            for _, result in finished:
                (self.failures if isinstance(result, FailedUnit) else self.results).append(result)
                yield result

    def rows(self) -> list[Row]:
        """One row per policy and estimator, over the buildings that all of them have finished."""
        names = dict.fromkeys(self.policies)
        return rows_of(self.results, [(name, setting.estimator) for setting in self.settings for name in names])

    def check_buildings(self, policies: Sequence[Policy]) -> None:
        """Raise `MecpError` for a wrong setting, a first plan that cannot be read, too many generated buildings, or a
        policy whose first action fails.
        """
        for name, policy in zip(self.policies, policies, strict=True):
            env = make_rooms(self.setting, policy)
            try_action(env, policy, name)
            env.close()
        if self.setting.layout or not policies:
            return
        env = make_rooms(self.setting, policies[0])
        try:
            env.reset(seed=0, options={"building": self.episodes - 1})
        except ConfigError as error:
            raise ConfigError(
                f"episodes: {self.episodes}, each in a building of {self.setting.split!r}; {error}"
            ) from None
        env.close()

    def figures(self, rows: Sequence[Row], command: str) -> Figures:
        """The result as JSON data. Apart from date, command and `timing`, every repetition gives the same."""
        estimated = [row for row in rows if row.estimator == self.setting.estimator]
        return {
            "date": datetime.now(UTC).date().isoformat(),
            "command": command,
            "system": f"{platform.system()} {platform.machine()}, python {platform.python_version()}",
            "setting": self.setting.named(),
            "plans": plan_names(self.setting)[: self.episodes],
            "budget_m_per_m2": BUDGET_M_PER_M2,
            "reference": self.reference,
            "buildings": len(rows[0].episodes),
            "interrupted": self.interrupted,
            "failures": sorted(str(failure) for failure in self.failures),
            "rows": compare(rows, self.reference),
            "seeds": seeds_of(estimated),
            "returns": returns_of(estimated),
            "timing": timing(rows),
        }

    def write_episodes(self, path: Path) -> None:
        """Write one CSV row per episode, in the order of policy, estimator and building."""
        ordered = sorted(self.results, key=lambda e: (e.task.policy, e.task.setting.estimator, e.task.building))
        with path.open("w", encoding="utf-8", newline="") as file:
            lines = csv.writer(file)
            lines.writerow(["policy", "estimator", "building", *ordered[0].figures])
            for result in ordered:
                task = result.task
                lines.writerow([task.policy, task.setting.estimator, task.building, *result.figures.values()])


def write_result(figures: Figures, text: str, json_path: Path, page_path: Path) -> None:
    """Write the figures as JSON, and the page, each whole or not at all."""
    write_atomic(json_path, (json.dumps(figures, indent=1) + "\n").encode())
    write_atomic(page_path, text.encode())
