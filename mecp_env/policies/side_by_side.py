"""All policies side by side in the same building, from the same start, in the same simulated time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mecp_env.core.array_types import Bytes
from mecp_env.policies.registry import make_policy
from mecp_env.policies.rollout import Env, Info, make_rooms, run_policy, watched
from mecp_env.policies.setting import Setting
from mecp_env.render.film import Film
from mecp_env.render.screen import thumbnail

PANEL = (320, 290)  # px
ACROSS = 3  # panels in a row
MOST_FRAMES, EVERY = 64, 4  # of a policy, and steps between the first of them
LONGEST = 900  # steps: longer episodes are cut
FIRST = 0, 0  # building and seed


class Recorder:
    """Draws the belief of a policy while it explores."""

    def __init__(self, policy: str, env: Env) -> None:
        self.policy, self.env = policy, env
        self.film = Film(MOST_FRAMES, EVERY)
        self.info: Info = {}

    def add(self, info: Info) -> None:
        """Take the picture of every n-th step."""
        self.info = info
        self.film.offer(info["period"], self.picture)

    def picture(self, ended: str = "") -> Bytes:
        """The belief, time, path length and coverage."""
        info = self.info
        time_s = self.env.get_wrapper_attr("config").robot.period_s * info["period"]
        words = f"{time_s:.0f} s    {info['metres']:.0f} m    {info['coverage']:.0%} seen{ended}"
        return thumbnail(self.env.get_wrapper_attr("view")(), PANEL, self.policy, words)


def write_film(policies: Sequence[str], setting: Setting, path: Path, trust: bool = False) -> None:
    """Write the film of all policies in one building as a GIF; long episodes are cut."""
    shorter = replace(setting, max_steps=min(setting.max_steps, LONGEST))
    films = [record(policy, shorter, trust) for policy in policies]
    every = max(film.every for film in films)
    last = max(film.every * (len(film.frames) - 1) for film in films)
    whole = Film()
    whole.frames = [mosaic([at(film, step) for film in films]) for step in range(0, last + every, every)]
    whole.save(path)


def record(policy: str, setting: Setting, trust: bool = False) -> Film:
    """The pictures of one exploration, with the last one."""
    made = make_policy(policy, trust)
    env = make_rooms(setting, made)
    recorder = Recorder(policy, env)
    run_policy(watched(env, recorder.add), made, recorder.add, FIRST)
    recorder.film.frames.append(recorder.picture("    ..." if recorder.info["goals"] else "    done"))
    env.close()
    return recorder.film


def at(film: Film, step: int) -> Bytes:
    """The picture at a step; after the end the last one."""
    return film.frames[min(-(-step // film.every), len(film.frames) - 1)]


def mosaic(pictures: list[Bytes]) -> Bytes:
    """The pictures in rows of three; missing ones have the colour of their border."""
    across = min(ACROSS, len(pictures))
    rest = -len(pictures) % across
    filled = [*pictures, *([np.full_like(pictures[0], pictures[0][0, 0])] * rest)]
    rows = [np.concatenate(filled[i : i + across], axis=1) for i in range(0, len(filled), across)]
    return np.concatenate(rows, axis=0)
