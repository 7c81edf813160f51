"""The parts of the speed benchmark measure what their names state."""

import numpy as np
import pytest

from benchmarks import crowd_speed, polygon_speed, speed
from benchmarks.in_tree import BEAMS
from benchmarks.stopwatch import STAGE_NAMES, STAGES, timed_stages
from mecp_env.env import MecpEnv
from mecp_env.world.layout import load_layout
from mecp_env.world.outline import build_outline, random_free_pose
from tests.world.rays import cast_rays


def test_the_three_ways_to_cast_rays_agree() -> None:
    outline = build_outline(load_layout("paper"))
    space = speed.pymunk_space(outline)
    for seed in range(5):
        pose = random_free_pose(outline, np.random.default_rng(seed), 0.3)
        exact = speed.brute_force(outline, pose)
        assert cast_rays(outline.segments, pose, BEAMS) == pytest.approx(exact, abs=1e-6)
        assert speed.query_pymunk(space, pose) == pytest.approx(exact, abs=1e-6)


def test_the_stopwatch_times_every_stage_and_leaves_no_trace() -> None:
    env = MecpEnv(layout="two_rooms")
    plain = [getattr(owner, name) for _, owner, name in STAGES]
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.array([0.2, 0.1]))
    with timed_stages() as watch:
        for _ in range(20):
            env.step(np.array([0.2, 0.1]))
    times = watch.microseconds()
    assert 0 < watch.steps <= 20
    assert all(times[name] > 0.0 for name in STAGE_NAMES if name != "goals")
    assert times["step"] == pytest.approx(times["rest"] + sum(times[name] for name in STAGE_NAMES))
    assert [getattr(owner, name) for _, owner, name in STAGES] == plain


def test_the_parts_have_a_page(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(crowd_speed, "RANDOM_STEPS", 5)
    monkeypatch.setattr(crowd_speed, "MAX_STEPS", 5)
    crowd = crowd_speed.measure(1)
    assert len(build_outline(crowd_speed.building(1)).segments) >= crowd_speed.LEAST_FACES
    assert all(settings["paper"]["ratio"]["value"] == 1.0 for settings in crowd.values())
    timed = {"steps_per_s": 1.0, "with_driver_per_s": 1.0, "us": {"step": 1.0}}
    figures = {"env": {"K=1": {"random": timed, "bfs": timed}}, "peers": {}, "crowd": crowd}
    figures |= {"rays": speed.rays(2), "polygon": polygon_speed.measure(1)}
    page = speed.report(figures)
    assert "| K=1, bfs | 1 | 1 |" in page
    assert "| bfs, 200 walls, 8 people |" in page
    assert "| n=40 |" in page
