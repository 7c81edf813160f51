"""Training in a task of active SLAM: known ground, predictions and confidence reach the network, or do not."""

import json

import gymnasium as gym
import numpy as np
import pytest

import mecp_env  # noqa: F401
from mecp_env.core.errors import ConfigError
from mecp_env.episode.tasks import TASKS
from mecp_env.learning.config import TrainConfig
from mecp_env.learning.encoder import make_network
from mecp_env.learning.environments import make_env
from mecp_env.learning.fits import downsampled_space
from mecp_env.learning.learned import load
from mecp_env.policies.active import Active, Returning, Stachniss
from mecp_env.policies.registry import KIND, LOOK, PATH, PLACE, SIGMA, SIGMA_RAD, VALID, WAIT
from mecp_env.policies.rollout import options_of
from tests.learning.training import logits, quick, resume, run, shaken

TASK = "ActiveHalls-v0"
SMALL = {"task": TASK, "env": {"max_steps": 60}, "buildings": {"spec": {"rooms": 3, "loops": 0}}}
THIN = {"width": 16, "grid_channels": 4}


@pytest.fixture(scope="module")
def seen():
    """Observations of a task in which there is known ground to choose."""
    env = gym.make(f"mecp_env/{TASK}", split="validation")
    policy, observation = Active(), env.reset(seed=1, options={"building": 1})[0]
    found = list[dict[str, np.ndarray]]()
    while len(found) < 4:
        observation, *_ = env.step(policy.act(observation, env.get_wrapper_attr("action_masks")()))
        if (observation["goals"][:, KIND] == PLACE).any():
            found.append(observation)
    return found


def test_a_task_sets_buildings_robot_and_reward_and_can_be_overridden():
    config = TrainConfig.build({"task": TASK, "env": {"max_steps": 700}, "buildings": {"spec": {"rooms": 4}}})
    assert config.env.reward.preset == TASKS[TASK]["reward"]["preset"]
    assert config.env.reward.correct_coverage == 1.0
    assert (config.env.max_steps, config.buildings.spec["rooms"]) == (700, 4)
    assert config.buildings.spec["loops"] == TASKS[TASK]["loops"]
    assert config.score == "correct_over_steps"
    assert TrainConfig.build(config.to_dict()) == config
    with pytest.raises(ConfigError, match="task: 'ActiveHall-v0', expected one of ActiveHalls-v0"):
        TrainConfig.build({"task": "ActiveHall-v0"})


def test_environment_and_network_of_a_task_have_the_same_space():
    config = quick(**SMALL)
    env = make_env(config)
    assert env.observation_space == make_network(config).observation_space
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    registered = gym.make(f"mecp_env/{TASK}")
    assert downsampled_space(registered.observation_space, goals=True) == env.observation_space


def test_an_untrained_policy_seldom_drives_to_known_ground_and_looks_elsewhere_when_lost(seen):
    network = make_network(quick(**SMALL))
    for observation in seen:
        scores, kinds = logits(network, observation), observation["goals"][:, KIND]
        valid = observation["goals"][:, VALID] > 0.5
        known = scores[valid & (kinds >= PLACE)]
        np.testing.assert_allclose(known, known[0], rtol=1e-5)
        assert scores[valid & (kinds < PLACE)].max() - known[0] == pytest.approx(5.0, abs=1e-4)
    lost = {name: values.copy() for name, values in seen[0].items()}
    lost["goals"][0, [KIND, VALID]] = LOOK, 1.0
    assert logits(network, lost).argmax() == 0


def test_an_untrained_policy_drives_as_stachniss_to_places_and_new_floor(seen):
    network = make_network(quick(**SMALL, network=THIN | {"prior": "stachniss"}))
    farther = {name: values.copy() for name, values in seen[0].items()}
    farther["goals"][farther["goals"][:, KIND] < PLACE, PATH] += 150.0  # so that it is a place
    chosen = list[int]()
    for observation in (*seen, farther):
        row, goals = Stachniss().act(observation), observation["goals"]
        scores = logits(network, observation)
        assert scores[goals[:, VALID] > 0.5].max() == scores[row]
        assert (scores[goals[:, KIND] == WAIT] < scores[row]).all()
        chosen.append(int(goals[row, KIND]))
    assert chosen[-1] == PLACE


def test_an_untrained_policy_returns_as_returning_does_when_its_pose_is_uncertain(seen):
    network = make_network(quick(**SMALL, network=THIN | {"prior": "returning"}))
    chosen = list[int]()
    for observation in seen:
        for sigma_m, there in ((0.05, 0.02), (0.5, 0.02), (0.5, 0.4)):
            given = {name: values.copy() for name, values in observation.items()}
            given["pose_cov"][:] = [sigma_m**2, 0, 0, sigma_m**2, 0, 1e-8]
            given["goals"][:, SIGMA], given["goals"][:, SIGMA_RAD] = there, 1e-3
            row, valid = Returning().act(given), given["goals"][:, VALID] > 0.5
            scores = logits(network, given)
            assert scores[valid].max() == scores[row]
            chosen.append(int(given["goals"][row, KIND]))
    assert PLACE in chosen[1::3]
    assert PLACE not in chosen[::3] + chosen[2::3]


@pytest.mark.parametrize("prior", ["returning", "stachniss"])
@pytest.mark.parametrize(
    ("fields", "why"), [({}, "only a `task` shows"), ({"task": TASK}, "network.uncertainty hides")]
)
def test_predictions_are_needed_by_a_prior_that_reads_them(prior, fields, why):
    with pytest.raises(ConfigError, match=f"network.prior: {prior} reads predictions, which {why}"):
        TrainConfig.build({**fields, "network": {"prior": prior, "uncertainty": "task" not in fields}})


@pytest.mark.parametrize(
    ("part", "place", "factor"),
    [
        ("goals", np.s_[:, SIGMA], 3.0),
        ("localisation", 0, 0.1),
        ("pose_cov", ..., 9.0),
        ("landmarks", np.s_[:, 2:5], 9.0),
    ],
    ids=["sigma of goals", "localisation", "covariance of the pose", "covariances of landmarks"],
)
def test_uncertainty_reaches_the_network_unless_it_is_hidden(part, place, factor, seen):
    changed = {key: values.copy() for key, values in seen[0].items()}
    changed[part][place] *= factor
    open_eyed, blind = (shaken(quick(**SMALL, network=THIN | {"uncertainty": shown})) for shown in (True, False))
    assert (logits(open_eyed, changed) - logits(open_eyed, seen[0])).abs().max() > 1e-5
    np.testing.assert_array_equal(logits(blind, changed), logits(blind, seen[0]))


@pytest.mark.slow
def test_a_run_in_a_task_resumes_and_its_policy_fits_that_observation_only(tmp_path, seen):
    folder, code = run(tmp_path, **SMALL)
    assert code == 0
    assert resume(folder, "--steps", "36") == 0
    figures = json.loads((folder / "policy.json").read_text())["validation"]
    assert 0.0 < figures["correct_over_steps"] <= 1.0
    policy = load(folder)
    allowed = seen[0]["goals"][:, VALID] > 0.5
    assert allowed[policy.act(seen[0], allowed)]
    assert options_of(policy)["observation"] == {"uncertainty": True}
    plain = gym.make("mecp_env/Rooms-v0", difficulty="easy", actions="goal").reset(seed=0)[0]
    with pytest.raises(ConfigError, match="reads `localisation`, the observation has pose, pose_cov"):
        policy.act(plain)
