"""The curves of a training: drawn from its tables, also from damaged or short ones."""

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("stable_baselines3")

from mecp_env.learning.run_folder import draw_training, measured, running_mean

PROGRESS = "decisions,reward,correct_coverage,lost\n512,,,\n1024,-3.5,0.4,1\n1536,2.0,0.7,0.5\n"
EVALUATION = "decisions,reward,correct_coverage,lost\n0,1.0,0.6,0.5\n"


def test_the_curves_are_drawn_from_the_tables_of_a_run(tmp_path):
    assert draw_training(tmp_path) is None
    (tmp_path / "progress.csv").write_text(PROGRESS.splitlines(keepends=True)[0])
    assert draw_training(tmp_path) is None  # before the first update
    assert not (tmp_path / "curves.png").exists()
    (tmp_path / "progress.csv").write_text(PROGRESS)
    before = draw_training(tmp_path).read_bytes()
    assert draw_training(tmp_path).read_bytes() == before
    with Image.open(tmp_path / "curves.png") as picture:
        width, height = picture.size
    assert width > 3 * height
    (tmp_path / "progress.csv").write_text("decisions,reward,correct_coverage,lost\n512,1.0,,\n1024,-3.5,,\n")
    with Image.open(draw_training(tmp_path)) as picture:
        assert picture.size == (width / 3, height)  # a column without values has no panel
    (tmp_path / "progress.csv").write_text(PROGRESS)
    (tmp_path / "evaluation.csv").write_text(EVALUATION)
    assert draw_training(tmp_path).read_bytes() != before


def test_updates_without_an_episode_are_left_out_and_a_running_mean_levels_noise():
    decisions, values = measured([{"decisions": "8", "reward": ""}, {"decisions": "16", "reward": "2.5"}], "reward")
    assert (decisions.tolist(), values.tolist()) == ([16.0], [2.5])
    np.testing.assert_allclose(running_mean(np.full(20, 3.0)), 3.0)
    np.testing.assert_allclose(running_mean(np.arange(9.0))[3:6], [3.0, 4.0, 5.0])
    assert running_mean(np.array([1.0, 3.0])).tolist() == [2.0, 2.0]
