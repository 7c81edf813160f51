"""All policies side by side in the same building, from the same start, in the same simulated time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mecp_env.policies.episode import drive
from mecp_env.policies.registry import make_agent
from mecp_env.policies.worlds import Env, Info, Setting, admit, rooms
from mecp_env.render.film import Film
from mecp_env.render.thumbnail import thumbnail

Image = NDArray[np.uint8]

PANEL = (320, 290)  # px
ACROSS = 3  # panels in a row
MOST_FRAMES, EVERY = 64, 4  # of a policy, and steps between the first of them
LONGEST = 900  # steps: what takes longer is shown so far
PERIOD_S = 0.4
BUILDING = 0


@dataclass(slots=True, eq=False)
class Reel:
    """The pictures of one policy, `every` so many steps."""

    frames: list[Image]
    every: int

    def at(self, step: int) -> Image:
        """The picture at a step; after the end the last one."""
        return self.frames[min(-(-step // self.every), len(self.frames) - 1)]


class Spectator:
    """Draws the belief of a policy while it explores."""

    def __init__(self, policy: str, env: Env) -> None:
        self.policy, self.env = policy, env
        self.film = Film(MOST_FRAMES, EVERY)
        self.info: Info = {}

    def look(self, observation: dict[str, Any], info: Info) -> None:
        """Take the picture of a step, where its turn has come."""
        self.info = info
        self.film.offer(info["period"], self.picture)

    def picture(self, ended: str = "") -> Image:
        """The belief, and how far it came."""
        info, time_s = self.info, PERIOD_S * self.info["period"]
        words = f"{time_s:.0f} s    {info['metres']:.0f} m    {info['coverage']:.0%} seen{ended}"
        return thumbnail(self.env.get_wrapper_attr("view")(), PANEL, self.policy, words)

    def reel(self) -> Reel:
        """All pictures, the one of the end too."""
        ended = "    done" if not self.info["goals"] else "    ..."
        return Reel([*self.film.frames, self.picture(ended)], self.film.every)


def write_film(policies: Sequence[str], setting: Setting, path: Path, trust: bool = False) -> None:
    """Write the film of all policies in one building as a GIF; what takes very long is shown so far."""
    shorter = replace(setting, max_steps=min(setting.max_steps, LONGEST))
    reels = [record(policy, shorter, trust) for policy in policies]
    every = max(reel.every for reel in reels)
    last = max(reel.every * (len(reel.frames) - 1) for reel in reels)
    whole = Film()
    whole.frames = [mosaic([reel.at(step) for reel in reels]) for step in range(0, last + every, every)]
    whole.save(path)


def record(policy: str, setting: Setting, trust: bool = False) -> Reel:
    """The pictures of one exploration."""
    agent = make_agent(policy, trust)
    env = rooms(setting, agent)
    spectator = Spectator(policy, env)
    drive(admit(env, agent, spectator.look), agent, spectator.look, BUILDING)
    reel = spectator.reel()
    env.close()
    return reel


def mosaic(pictures: list[Image]) -> Image:
    """The pictures in rows of three; the place of one that is missing has the colour of their border."""
    across = min(ACROSS, len(pictures))
    rest = -len(pictures) % across
    filled = [*pictures, *([np.full_like(pictures[0], pictures[0][0, 0])] * rest)]
    rows = [np.concatenate(filled[i : i + across], axis=1) for i in range(0, len(filled), across)]
    return np.concatenate(rows, axis=0)
