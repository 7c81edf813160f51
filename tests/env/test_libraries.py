"""Libraries that people train and record with take the environments as they are, in each format of the observation."""

from pathlib import Path
from typing import Any

import pytest
from gymnasium import wrappers

from mecp_env.wrappers import GoalActions
from tests.env.helpers import make, until_over

FORMATS = ("flat", "image")
WRAPPERS = {
    "statistics": wrappers.RecordEpisodeStatistics,
    "flatten": wrappers.FlattenObservation,
    "stack": lambda env: wrappers.FrameStackObservation(env, 4),
    "time": lambda env: wrappers.TimeAwareObservation(wrappers.TimeLimit(env, 50)),
}


def ended(env: Any, steps: int = 12) -> int:
    """How many episodes ended in some random steps, in each of which the observation is in its space."""
    env.action_space.seed(1)
    observation, _ = env.reset(seed=1)
    count = 0
    for _ in range(steps):
        assert env.observation_space.contains(observation)
        observation, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            count += 1
            observation, _ = env.reset()
    return count


@pytest.mark.parametrize("name", WRAPPERS)
def test_wrappers_of_gymnasium(name: str) -> None:
    for observation in ("dict",) if name == "flatten" else FORMATS:
        assert ended(WRAPPERS[name](make(observation=observation, max_steps=5))) == 2


def test_a_film_of_goal_actions_shows_every_control_step(tmp_path: Path) -> None:
    pytest.importorskip("moviepy", reason="needs the extra video")
    recorder = wrappers.RecordVideo(
        make(render_mode="rgb_array", max_steps=12), str(tmp_path / "films"), disable_logger=True
    )
    env = GoalActions(recorder)
    env.reset(seed=0)
    *_, (*_, info) = until_over(env, lambda _: 0)
    assert len(recorder.recorded_frames) == info["period"] + 1
    env.close()
