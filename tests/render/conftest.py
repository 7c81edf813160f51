"""An episode and its replay page, for all tests of the page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest

import mecp_env  # noqa: F401  (registers the environments)
from mecp_env.policies.explorers import Nearest
from mecp_env.policies.rollout import masks_of
from mecp_env.wrappers import RecordReplay


class Seen(RecordReplay):
    """The wrapper, with the views that it was given."""

    def _keep(self, view: Any, info: Any) -> None:
        if info is not None:
            self.views = [*getattr(self, "views", []), view]
        super()._keep(view, info)


@pytest.fixture(scope="session")
def kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Any]]:
    """The page of an episode, and the views of its steps."""
    folder = tmp_path_factory.mktemp("replays")
    env = Seen(gym.make("mecp_env/Layout-v0", layout="two_rooms", actions="goal", disable_env_checker=True), folder)
    observation, _ = env.reset(seed=3)
    policy, over = Nearest(), False
    policy.reset(0)
    while not over:
        observation, _, terminated, truncated, _ = env.step(policy.act(observation, masks_of(env)()))
        over = terminated or truncated
    env.close()
    return folder / "episode-0000.html", env.views


@pytest.fixture
def page(kept: tuple[Path, list[Any]]) -> Path:
    return kept[0]
