"""The curves of a training: drawn from its tables, also from damaged or short ones."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("stable_baselines3")

from mecp_env.learning.run_log import draw_training, measured, running_mean

PROGRESS = "decisions,reward,correct_coverage,lost\n512,,,\n1024,-3.5,0.4,1\n1536,2.0,0.7,0.5\n"
EVALUATION = "decisions,reward,correct_coverage,lost\n0,1.0,0.6,0.5\n"


def test_the_curves_are_drawn_from_the_tables_of_a_run(tmp_path):
    (tmp_path / "progress.csv").write_text(PROGRESS)
    before = draw_training(tmp_path).read_bytes()
    assert draw_training(tmp_path).read_bytes() == before
    (tmp_path / "evaluation.csv").write_text(EVALUATION)
    with Image.open(draw_training(tmp_path)) as picture:
        assert picture.width > 3 * picture.height
    assert (tmp_path / "curves.png").read_bytes() != before


def test_a_column_without_values_has_no_panel(tmp_path):
    """The tables of a run without uncertainty have no correct coverage."""
    (tmp_path / "progress.csv").write_text(PROGRESS)
    with Image.open(draw_training(tmp_path)) as picture:
        whole = picture.size
    (tmp_path / "progress.csv").write_text("decisions,reward,correct_coverage,lost\n512,1.0,,\n1024,-3.5,,\n")
    with Image.open(draw_training(tmp_path)) as picture:
        assert picture.size == (whole[0] / 3, whole[1])


def test_nothing_is_drawn_before_the_first_update(tmp_path):
    assert draw_training(tmp_path) is None
    (tmp_path / "progress.csv").write_text(PROGRESS.splitlines(keepends=True)[0])
    assert draw_training(tmp_path) is None
    assert not (tmp_path / "curves.png").exists()


def test_updates_in_which_no_episode_finished_are_left_out():
    decisions, values = measured([{"decisions": "8", "reward": ""}, {"decisions": "16", "reward": "2.5"}], "reward")
    assert (decisions.tolist(), values.tolist()) == ([16.0], [2.5])


def test_a_running_mean_keeps_constants_and_levels_noise():
    np.testing.assert_allclose(running_mean(np.full(20, 3.0)), 3.0)
    np.testing.assert_allclose(running_mean(np.arange(9.0))[3:6], [3.0, 4.0, 5.0])
    assert running_mean(np.array([1.0, 3.0])).tolist() == [2.0, 2.0]
