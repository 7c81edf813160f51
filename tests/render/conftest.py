"""An episode and its replay page, for all tests of the page."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest

from mecp_env.policies.explorers import Nearest
from mecp_env.policies.rollout import masks_of
from mecp_env.wrappers import RecordReplay
from tests.env.helpers import until_over


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
    policy = Nearest()
    policy.reset(0)
    for _ in until_over(env, lambda seen: policy.act(seen, masks_of(env)()), observation):
        pass
    env.close()
    return folder / "episode-0000.html", env.views


@pytest.fixture
def page(kept: tuple[Path, list[Any]]) -> Path:
    return kept[0]
