"""Each term of the reward: formula and unit, more reward for better results, none for detours."""

import math
from itertools import pairwise

import gymnasium
import numpy as np
import pytest
from scipy import stats
from scipy.special import erf

from mecp_env.config import EnvConfig, RewardConfig
from mecp_env.core.errors import ConfigError
from mecp_env.episode.potentials import (
    BLOCK_CELLS,
    NEAR_M,
    TAU_M,
    MetricMemory,
    RewardInputs,
    a_optimality,
    coverage,
    d_optimality,
    entropy,
    expected_area,
    expected_correct_m2,
    metric_terms,
    nearness,
    register_reward,
    start_metrics,
    t_optimality,
)
from mecp_env.episode.rewards import (
    RewardMemory,
    events,
    information,
    measured_terms,
    new_memory,
)
from mecp_env.slam.messages import Cell
from tests.env.helpers import drive, episode_of, make, started, until_over, world_of
from tests.env.make import happened, reward_inputs
from tests.slam.make import belief, grid

CONFIG = RewardConfig(preset="terms")
CELL_M2 = 0.25
SURE, LOST = 1e-4, 1.0  # variances of a pose, m^2 and rad^2
NO_COVS = np.empty((0, 2, 2))
POTENTIALS = ("expected_area", "entropy", "d_optimality", "a_optimality", "t_optimality")


def moment(
    known: int = 0, version: int = 0, diverged: bool = False, pose: float = SURE, landmarks: tuple[float, ...] = (0.01,)
) -> RewardInputs:
    """So many known cells, a pose and landmarks of these variances."""
    believed = belief(p_map=np.zeros((len(landmarks), 2)), pose_cov=pose, covs=landmarks)
    label = (np.arange(100) < known).reshape(10, 10)
    return reward_inputs(believed, grid(label, resolution_m=0.5, version=version), diverged=diverged)


def sums(*moments: RewardInputs, config: RewardConfig = CONFIG) -> dict[str, float]:
    """The sums of the measured terms over an episode with these states."""
    memory = new_memory(moments[0], config)
    rows = [measured_terms(memory, now, config) for now in moments[1:]]
    return {name: sum(row[name] for row in rows) for name in rows[0]}


def test_quantities_in_their_units():
    measured = sums(
        moment(known=10, version=1, pose=4e-4, landmarks=(0.04, 0.01)),
        moment(known=30, version=2, pose=1e-4, landmarks=(0.01, 0.01)),
    )
    expected = {"area": 20 * CELL_M2, "pose_information": 0.5 * 3 * np.log(4.0)}
    expected["landmark_information"] = 0.5 * np.log(4.0)  # log 4 of one, nothing of the other
    assert {name: measured[name] for name in expected} == pytest.approx(expected)


def test_area_drawn_from_a_pose_that_is_not_known_counts_once_it_is_known_again():
    begin, drawn = moment(10, 1), moment(60, 2, pose=LOST)
    assert sums(begin, drawn)["area"] == 0.0
    assert sums(begin, drawn, moment(70, 3, pose=LOST))["area"] == 0.0
    assert sums(begin, drawn, moment(60, 2))["area"] == pytest.approx(50 * CELL_M2)  # it stood
    assert sums(begin, drawn, moment(20, 3))["area"] == pytest.approx(10 * CELL_M2)  # it did not


def test_how_well_is_drawn():
    assert information(np.diag([0.04, 0.09, 0.0]), NO_COVS)[0] == pytest.approx(0.3)
    assert information(np.diag([0.0, 0.0, 1e-4]), NO_COVS)[0] == pytest.approx(0.05)  # 5 m ahead
    assert information(np.full((3, 3), np.nan), NO_COVS)[0] == information(-np.eye(3), NO_COVS)[0] == np.inf
    unsure = moment(60, 2, pose=0.01)
    assert sums(moment(10, 1), unsure)["area"] == 0.0
    assert sums(moment(10, 1), unsure, config=RewardConfig(area_sigma_m=1.0))["area"] > 0.0


def test_a_map_that_diverged_is_worth_nothing_and_the_first_landmark_counts_from_a_metre():
    measured = sums(moment(10, 1), moment(80, 2), moment(90, 3, diverged=True))
    assert measured["area"] == pytest.approx(-10 * CELL_M2)  # the area of the start is lost too
    assert measured["landmark_information"] == pytest.approx(0.5 * 2 * np.log(0.01))
    assert sums(moment(landmarks=()), moment(landmarks=(0.01,)))["landmark_information"] == pytest.approx(np.log(100.0))


@pytest.mark.parametrize("seed", range(4))
def test_no_detour_earns_anything(seed):
    """Growing, shrinking, creating, removing, painting and repainting: back at the start the sums are 0."""
    rng, config = np.random.default_rng(seed), RewardConfig(preset="terms", **dict.fromkeys(POTENTIALS, 1.0))
    begin = moment(20, 1, pose=SURE, landmarks=(0.01, 0.02))
    detour = []
    for version in range(2, 30):
        landmarks = tuple(10.0 ** rng.uniform(-5, 1, rng.integers(0, 6)))
        detour.append(moment(int(rng.integers(0, 100)), version, pose=10.0 ** rng.uniform(-6, 1), landmarks=landmarks))
    back = moment(20, 99, pose=SURE, landmarks=(0.01, 0.02))
    earned = sums(begin, *detour, back, config=config)
    assert earned == pytest.approx(dict.fromkeys(earned, 0.0), abs=1e-9)
    away, unweighted = sums(begin, detour[0], config=config), sums(begin, detour[0])
    assert all(away[name] != 0.0 == unweighted[name] for name in POTENTIALS)


@pytest.mark.parametrize("seed", range(5))
def test_information_is_that_of_determinants_and_finite(seed):
    rng = np.random.default_rng(seed)
    pose, landmarks = (a @ a.swapaxes(-1, -2) for a in (rng.normal(size=(3, 3)), rng.normal(size=(7, 2, 2))))
    _, of_pose, of_landmarks = information(pose, landmarks)
    assert of_pose == pytest.approx(-0.5 * np.linalg.slogdet(pose)[1])
    assert of_landmarks == pytest.approx(np.mean(-0.5 * np.linalg.slogdet(landmarks)[1]))
    assert information(1e-300 * pose, NO_COVS)[1:] == (60.0, 0.0)
    for spoilt in (-1.0, np.nan):
        assert information(spoilt * pose, spoilt * landmarks)[1:] == (-60.0, -60.0)


def test_events():
    memory = RewardMemory(area_m2=150.0)
    calm = dict.fromkeys(("contact", "contact_share", "lost_share", "completion", "divergence", "lost"), 0.0)
    calm["time"] = 1.0
    assert events(memory, happened()) == calm
    hit = happened(contact=True, diverged=True, max_steps=500)
    assert events(memory, hit) == calm | {"contact": 1.0, "contact_share": 0.002, "divergence": 1.0}
    assert events(memory, happened(off=True, max_steps=500)) == calm | {"lost_share": 0.002}
    assert events(memory, happened(lost_m2=50.0)) == calm | {"lost": 3.5}
    assert events(memory, happened(terminated=True))["completion"] == 1.5  # of 100 m^2


@pytest.mark.parametrize("source", ["belief", "truth"])
def test_the_area_of_an_episode_telescopes(source):
    env = started(reward={"source": source, "area": 1.0})
    start, before = episode_of(env).memory.area_m2, env.info()["coverage"]
    rows = drive(env, 15)
    gained = sum(row[4]["reward_area"] for row in rows)
    assert gained == pytest.approx(episode_of(env).memory.area_m2 - start)
    if source == "truth":
        seen = rows[-1][4]["coverage"] - before
        assert gained == pytest.approx(seen * world_of(env).truth.free_cells * 0.01)


def test_a_filter_that_diverged_completes_nothing():
    env = started(end={"coverage": 0.1}, reward="terms")
    episode_of(env).pipeline.divergence.found = True
    observation, reward, terminated, truncated, info = env.step(np.zeros(2, np.float32))
    assert (terminated, truncated, info["diverged"]) == (False, True, True)
    assert observation in env.observation_space
    assert (info["reward_divergence"], info["reward_completion"]) == (-20.0, 0.0)
    assert info["reward_area"] < 0.0
    assert reward < -20.0


FREE_M2 = 50.0
TRUTH = {"source": "truth", "contact_share": 0.0, "lost_share": 0.0}


def run(env: gymnasium.Env, seed: int, speed: float, metric: str) -> tuple[float, float]:
    """The return of a random walk, and the metric over its steps."""
    env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    rows = list(until_over(env, lambda _: rng.uniform(-speed, speed, 2).astype(np.float32)))
    return sum(row[1] for row in rows), rows[-1][4][f"{metric}_over_steps"]


@pytest.mark.parametrize(
    ("metric", "shaping", "end"), [("coverage", 0.0, {}), ("correct_coverage", 0.3, {"coverage": 0.6})]
)
def test_with_the_source_truth_the_return_is_the_metric(metric: str, shaping: float, end: dict[str, float]) -> None:
    rewards = {"preset": metric, "shaping": shaping, **TRUTH}, {"preset": metric, "pace": 1.0, **TRUTH}
    (env, paced), moved = (make(max_steps=60, end=end, reward=reward) for reward in rewards), []
    for seed, speed in enumerate((0.5, 1.0)):
        returned, expected = run(env, seed, speed, metric)
        assert returned == pytest.approx(expected, abs=1e-9)
        assert 0.0 < returned <= 1.0
        returned, expected = run(paced, 0, speed, metric)
        moved.append(returned - expected)
    assert moved == pytest.approx([moved[0]] * 2, abs=1e-9)  # pace moves the return by what no action changes
    assert -1.0 < moved[0] < 0.0


def test_rewards_are_those_of_the_formula_and_at_pace_1_a_step_costs_what_is_missing() -> None:
    shares, limit, paid = [0.1, 0.3, 0.2, 0.5], 3, []
    for pace in (0.0, 1.0):
        config, memory = RewardConfig(preset="coverage", pace=pace), MetricMemory()
        start_metrics(memory, inputs_of(shares[0], 1.0), config)
        memory.owed.clear()
        for step, (before, share) in enumerate(pairwise(shares), start=1):
            terms = metric_terms(memory, inputs_of(share, 1.0 - step / limit), config)
            paid += [terms["coverage"]] if pace == 0.0 else []
            assert pace == 0.0 or terms["coverage"] + terms["pace"] == pytest.approx(-(1.0 - before) / limit)
    assert paid == pytest.approx([0.2 * 2 / 3, -0.1 * 1 / 3, 0.0])
    assert 0.1 + sum(paid) == pytest.approx(np.mean(shares[:limit]))


def test_floor_beyond_the_building_counts_once_and_the_nearest_goal() -> None:
    memory = MetricMemory(floor_m2=2.0 * FREE_M2)
    inputs = inputs_of(None, 1.0)
    assert coverage(memory, inputs) == 1.0
    assert coverage(memory, inputs._replace(diverged=True)) == 0.0
    assert nearness(inputs) == 0.0
    near = inputs._replace(p_goals=np.array([[3.0, 4.0], [30.0, 0.0]]))
    assert nearness(near) == pytest.approx(np.exp(-5.0 / NEAR_M))


@pytest.mark.parametrize("seed", range(5))
def test_expected_correct_area_against_a_plain_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    label = rng.integers(0, 4, (21, 37)).astype(np.uint8)
    origin, side = rng.uniform(-5, 5, 2), 0.1
    p_map, spread = rng.uniform(-5, 5, (6, 2)), rng.uniform(0.001, 0.3, 6)
    inputs = reward_inputs(belief(p_map=p_map, covs=spread), grid(label, origin=origin))
    expected = 0.0
    for i, j in np.argwhere((label == Cell.FREE) | (label == Cell.DOOR)):
        block = np.array([j // BLOCK_CELLS, i // BLOCK_CELLS]) + 0.5
        nearest = np.argmin(np.hypot(*(p_map - origin - block * BLOCK_CELLS * side).T))
        expected += side**2 * erf(0.25 / np.sqrt(2.0 * spread[nearest]))
    assert expected_correct_m2(inputs) == pytest.approx(expected)
    assert expected_correct_m2(inputs._replace(diverged=True)) == 0.0


def test_presets_and_what_contradicts_them() -> None:
    assert EnvConfig().reward == EnvConfig(reward="coverage").reward
    for field, preset in (("area", "terms"), ("contact_share", "coverage")):  # weights alone
        assert EnvConfig.build(reward={field: -0.2}).reward.preset == preset
    assert EnvConfig.build({"reward": "correct_coverage"}, reward="terms").reward.completion == 10.0
    for name, value in (("area", 0.2), ("contact", -1.0), ("correct_coverage", 0.5)):
        with pytest.raises(ConfigError, match=rf"(?s){name}.*'coverage'"):
            EnvConfig(reward={"preset": "coverage", name: value})
    with pytest.raises(ConfigError, match="did you mean 'coverage'"):
        EnvConfig(reward="covrage")
    assert EnvConfig.build(EnvConfig(reward="active_terms").to_dict()) == EnvConfig(reward="active_terms")


def inputs_of(share: float | None, budget: float) -> RewardInputs:
    """Inputs with a true coverage, or the belief's."""
    shares = None if share is None else (share, share)
    empty = grid(np.zeros((8, 8)), resolution_m=0.5)
    return reward_inputs(belief(), empty, true_shares=shares, free_area_m2=FREE_M2, budget=budget)


def half_known(sigmas: tuple[float, ...], pose: float = 1e-2, diverged: bool = False) -> RewardInputs:
    """The left half of a grid of 8 m by 4 m is known, and landmarks at 1 m, 5 m, ... of these sigmas."""
    p_map = [(1.0 + 4.0 * n, 2.0) for n in range(len(sigmas))]
    known = belief(p_map=p_map, pose_cov=pose**2, covs=np.square(sigmas))
    return reward_inputs(known, grid(np.tile(np.arange(80) < 40, (40, 1))), diverged=diverged)


def reliability(sigma: float) -> float:
    return 1.0 - math.exp(-(TAU_M**2) / (2.0 * sigma**2))


def test_expected_area_is_the_mapped_area_times_the_reliability_of_the_nearest_landmark() -> None:
    assert expected_area(half_known((0.1,))) == pytest.approx(16.0 * reliability(0.1))
    split = 4.0 * (3.2 * reliability(0.05) + 0.8 * reliability(0.5))  # the second landmark is nearer from 3 m on
    assert expected_area(half_known((0.05, 0.5))) == pytest.approx(split, rel=0.05)


def test_entropy_is_that_of_cells_that_are_right_with_a_probability() -> None:
    right = 0.5 * (1.0 + reliability(0.1))
    assert entropy(half_known((0.1,))) == pytest.approx(16.0 * (math.log(2.0) - stats.bernoulli(right).entropy()))


def test_optimality_criteria_of_eigenvalues() -> None:
    now = half_known((0.1, 0.4), pose=0.2)
    now.belief.covs[1] = [[0.16, 0.07], [0.07, 0.1]]
    values = np.array([0.04, 0.04, 0.04, 0.01, 0.01, *np.linalg.eigvalsh(now.belief.covs[1])])
    assert d_optimality(now) == pytest.approx(-0.5 * np.log(values).mean())
    assert a_optimality(now) == pytest.approx(-0.5 * math.log(values.mean()))
    assert t_optimality(now) == pytest.approx(0.5 * math.log((1.0 / values).mean()))


@pytest.mark.parametrize("potential", [expected_area, entropy, d_optimality, a_optimality, t_optimality])
def test_a_better_belief_is_worth_more_and_a_diverged_one_least(potential) -> None:
    poor, good = potential(half_known((0.3, 0.3))), potential(half_known((0.1, 0.1)))
    assert good > poor > potential(half_known((0.1, 0.1), diverged=True))


def landmarks_seen(inputs: RewardInputs) -> float:
    return float(len(inputs.belief.ids))


def test_a_custom_reward_by_name() -> None:
    register_reward("landmarks_seen", landmarks_seen)
    env = started(reward={"custom": {"landmarks_seen": 2.0}})
    begin, rows = env.info()["landmarks"], drive(env, 15)
    assert sum(row[4]["reward_landmarks_seen"] for row in rows) == 2.0 * (rows[-1][4]["landmarks"] - begin)


WRONG = [
    ({"landmark_seen": 1.0}, r"custom\.landmark_seen: landmark_seen: not registered.*did you mean 'landmarks_seen'"),
    ({"area": 1.0}, "area: one of ours"),
]
FAILING = [
    (lambda inputs: math.nan, "gave nan.*, a finite number expected"),
    (lambda inputs: None, "gave None.*, a finite number expected"),
    (lambda inputs: inputs.walls, r"failed: AttributeError: .*\(<lambda>, line \d+\)"),
]


def test_a_wrong_custom_reward_is_named() -> None:
    register_reward("landmarks_seen", landmarks_seen)
    for custom, message in WRONG:
        with pytest.raises(ConfigError, match=message):
            make(reward={"custom": custom})
    for name, potential in (("two words", landmarks_seen), ("seen", 3)):
        with pytest.raises(ConfigError):
            register_reward(name, potential)
    for potential, said in FAILING:
        register_reward("wrong", potential)
        with pytest.raises(ConfigError, match=f"potential 'wrong' {said}"):
            make(reward={"custom": {"wrong": 1.0}}).reset(seed=0)
