"""The benchmark of the replay."""

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import mecp_env  # noqa: F401  (registers the environments)
from benchmarks import replay
from benchmarks.browser import chromium
from mecp_env.wrappers import RecordReplay


@pytest.mark.skipif(chromium() is None, reason="no Chromium on this machine")
def test_a_page_is_timed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay, "PLAYED_S", 0.3)
    env = RecordReplay(gym.make("mecp_env/Layout-v0", layout="two_rooms", disable_env_checker=True), tmp_path)
    env.reset(seed=0)
    for _ in range(20):
        env.step(np.array([0.5, 0.1], np.float32))
    env.close()
    first, rate = replay.show(tmp_path / "episode-0000.html")
    assert 0.0 < first < 60.0
    assert rate > 0.0
