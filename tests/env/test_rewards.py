from __future__ import annotations

import numpy as np
import pytest

from mecp_env.config import RewardConfig
from mecp_env.rewards import TERMS, RewardMemory, half_log_det, quantities, remember, trace_drop, weigh
from mecp_env.slam.data import Belief, SemanticGrid
from tests.env.helpers import drive, make


def grid_of(known: int, version: int) -> SemanticGrid:
    label = np.zeros((10, 10), np.uint8)
    label.flat[:known] = 1
    return SemanticGrid(label, label > 0, np.zeros((10, 10), np.int16), np.zeros(2), 0.5, version)


def belief_of(scale: float, traces: dict[int, float]) -> Belief:
    covs = np.array([np.eye(2) * trace / 2 for trace in traces.values()]).reshape(-1, 2, 2)
    return Belief(np.zeros(3), np.eye(3) * scale, np.array(list(traces), np.int64), np.zeros((len(traces), 2)), covs)


def test_quantities_in_their_units():
    memory = RewardMemory()
    remember(memory, belief_of(1.0, {3: 0.5, 7: 0.2}), grid_of(10, 1), None)
    measured = quantities(memory, belief_of(0.25, {3: 0.1, 7: 0.2, 9: 5.0}), grid_of(30, 2))
    assert measured["area"] == pytest.approx(20 * 0.25)
    assert measured["pose_information"] == pytest.approx(0.5 * 3 * np.log(4.0))
    assert measured["landmark_information"] == pytest.approx(0.4)  # the new landmark does not count yet
    measured = quantities(memory, belief_of(0.25, {3: 0.1, 9: 4.0}), grid_of(30, 2))
    assert measured == pytest.approx({"area": 0.0, "pose_information": 0.0, "landmark_information": 1.0})


def test_the_true_area_counts_where_it_is_asked_for():
    memory = RewardMemory()
    remember(memory, belief_of(1.0, {}), grid_of(10, 1), 3.0)
    assert quantities(memory, belief_of(1.0, {}), grid_of(90, 2), 4.5)["area"] == 1.5


@pytest.mark.parametrize("seed", range(5))
def test_trace_drop_against_a_plain_twin(seed):
    rng = np.random.default_rng(seed)
    before = {int(i): float(rng.random()) for i in rng.permutation(30)[: rng.integers(0, 20)]}
    now = {int(i): float(rng.random()) for i in rng.permutation(30)[: rng.integers(0, 20)]}
    drop = trace_drop(
        *(np.array(list(x), t) for d in (before, now) for x, t in ((d.keys(), np.int64), (d.values(), float)))
    )
    assert drop == pytest.approx(sum(before[i] - now[i] for i in before if i in now))


def test_half_log_det_is_finite_and_right():
    rng = np.random.default_rng(0)
    a = rng.normal(size=(3, 3))
    cov = a @ a.T + np.eye(3)
    assert half_log_det(cov) == pytest.approx(0.5 * np.linalg.slogdet(cov)[1])
    assert half_log_det(np.eye(3) * 1e-300) == -60.0
    assert half_log_det(-np.eye(3)) == half_log_det(np.full((3, 3), np.nan)) == 60.0


def test_weights():
    config = RewardConfig(area=2.0, contact=-3.0, time=-1.0, pose_information=0.0, landmark_information=0.0)
    measured = dict.fromkeys(TERMS, 1.0)
    assert weigh(config, measured) == {
        "area": 2.0,
        "pose_information": 0.0,
        "landmark_information": 0.0,
        "contact": -3.0,
        "time": -1.0,
        "completion": 10.0,
    }


@pytest.mark.parametrize("source", ["belief", "truth"])
def test_the_area_of_an_episode_telescopes(source):
    env = make(reward={"source": source, "area": 1.0})
    _, info = env.reset(seed=1)
    base = env.unwrapped
    start = base._episode.memory.area_m2
    assert start > 5.0
    rows = drive(env, 15)
    gained = sum(row[4]["reward_area"] for row in rows)
    assert gained == pytest.approx(base._episode.memory.area_m2 - start)
    if source == "truth":
        coverage = rows[-1][4]["coverage"] - info["coverage"]
        assert gained == pytest.approx(coverage * base._site.truth.free_cells * 0.01)


def test_a_contact_costs():
    env = make()
    env.reset(seed=1)
    for _ in range(12):
        _, _, _, _, info = env.step(np.array([-1.0, 0.0], np.float32))  # backwards into the nearest wall
        assert info["reward_contact"] == (-0.1 if info["contact"] else 0.0)
        assert info["reward_time"] == -0.005
    assert info["contact"]
    assert info["contacts"] > 0
