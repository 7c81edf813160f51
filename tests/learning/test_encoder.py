import gymnasium as gym
import numpy as np
import pytest
import torch

import mecp_env  # noqa: F401
from mecp_env.learning import tables
from mecp_env.learning.encoder import make_network, used_rows
from mecp_env.learning.fits import downsample, downsampled_space
from mecp_env.policies.explorers import Nearest, NextBestView
from tests.learning.training import batch, logits, quick, shaken


@pytest.fixture(scope="module")
def seen():
    """Observations of an exploration that has goals to choose from."""
    env = gym.make("mecp_env/Rooms-v0", difficulty="medium", split="validation", actions="goal")
    found = [env.reset(seed=1, options={"building": 3})[0]]
    found += [env.step(0)[0] for _ in range(8)]
    return [observation for observation in found if observation["goals"][:, 8].sum() > 1]


def test_downsampled_observations_are_in_their_space_and_means_of_the_grid(seen):
    env = gym.make("mecp_env/Rooms-v0", difficulty="easy")
    space = downsampled_space(env.observation_space, goals=True)
    assert space == make_network(quick()).observation_space
    for observation in seen:
        made = downsample(observation, goals=True)
        assert space.contains(made)
        blocks = observation["grid"].reshape(8, 24, 4, 24, 4).astype(float).mean((2, 4))
        assert np.abs(made["coarse"] - blocks).max() <= 1.0
        assert np.array_equal(made["near"], observation["grid"][:, 32:64, 32:64])


def test_the_order_of_goals_permutes_their_scores_and_that_of_landmarks_changes_nothing(seen):
    policy = shaken(quick())
    for observation in seen:
        order = np.random.default_rng(0).permutation(32)
        other = observation | {"goals": observation["goals"][order]}
        valid = other["goals"][:, 8] > 0.5
        before, after = logits(policy, observation)[order], logits(policy, other)
        assert torch.allclose(before[valid] - before[valid][0], after[valid] - after[valid][0], atol=1e-4)
        with torch.no_grad():
            mine, theirs = (policy.predict_values(batch(given)) for given in (observation, other))
        assert torch.allclose(mine, theirs, atol=1e-4)
        other = observation | {"landmarks": np.random.default_rng(1).permutation(observation["landmarks"])}
        assert torch.allclose(logits(policy, observation), logits(policy, other), atol=1e-4)


@pytest.mark.parametrize("algorithm", ["maskable_ppo", "ppo"])
def test_rows_that_hold_nothing_have_no_influence(algorithm, seen):
    policy = shaken(quick(algorithm))
    rng = np.random.default_rng(2)
    for observation in seen:
        goals, landmarks = observation["goals"].copy(), observation["landmarks"].copy()
        for rows in (goals, landmarks):
            empty = rows[:, -1] < 0.5
            rows[empty, :-1] = rng.uniform(0, 3, (int(empty.sum()), rows.shape[1] - 1))
        other = observation | {"goals": goals, "landmarks": landmarks}
        with torch.no_grad():
            given = (batch(each, algorithm == "maskable_ppo") for each in (observation, other))
            mine, theirs = (policy.extract_features(each) for each in given)
        assert torch.equal(mine, theirs)


@pytest.mark.parametrize(("prior", "explorer"), [("nearest", Nearest()), ("gain", NextBestView())])
def test_an_untrained_policy_does_as_the_explorer_it_begins_with(prior, explorer, seen):
    policy = make_network(quick(network={"width": 16, "grid_channels": 4, "prior": prior}))
    for observation in seen:
        valid = observation["goals"][:, 8] > 0.5
        row, _ = policy.predict(downsample(observation, goals=True), action_masks=valid, deterministic=True)
        assert row == explorer.act(observation, valid)


def test_the_grid_is_read_where_the_goal_lies():
    """A cell that is set 3 m ahead and 2 m to the left shows at a goal there, and at none elsewhere."""
    grid = np.zeros((8, 96, 96), np.uint8)
    grid[3, 48 - 15 - 2 : 48 - 15 + 2, 48 - 10 - 2 : 48 - 10 + 2] = 255
    goals = np.zeros((1, 32, 9), np.float32)
    goals[0, :3, :2] = (3.0, 2.0), (3.0, -2.0), (30.0, 0.0)
    coarse = downsample(
        {"grid": grid, **dict.fromkeys(("pose", "pose_cov", "landmarks", "goals"), goals)}, goals=False
    )["coarse"]
    shown = tables.at_goals(torch.as_tensor(coarse[None] / 255.0).float(), torch.as_tensor(goals))[0, :3]
    assert shown[0, 3] > 0.5
    assert shown[1, 3] == 0.0
    assert shown[:, 8].tolist() == [1.0, 1.0, 0.0]


def test_all_inputs_of_the_network_are_of_size_one(seen):
    for observation in seen:
        given = batch(observation)
        rows, valid = tables.goal_rows(given["goals"])
        landmarks, _ = tables.landmark_rows(given["landmarks"])
        pose = tables.pose_row(given["pose"], given["pose_cov"])
        assert max(float(part.abs().max()) for part in (landmarks, pose)) < 5.0
        assert rows.abs().max() <= 5.0  # a goal counts as 10 m wide at most, which is exactly 5
        assert valid.sum() == observation["goals"][:, 8].sum()


@pytest.mark.parametrize("algorithm", ["maskable_ppo", "ppo"])
def test_a_batch_gives_each_observation_the_features_that_it_has_alone(algorithm, seen):
    """Rows that are empty in all observations of a batch are left out; their number differs here."""
    encoder, goals = shaken(quick(algorithm)).features_extractor, algorithm == "maskable_ppo"
    rows = [{name: part.float() for name, part in batch(each, goals).items()} for each in seen]
    rows = [row | {name: row[name] / 255.0 for name in ("coarse", "near")} for row in rows]
    rows.append({name: torch.zeros_like(part) for name, part in rows[0].items()})
    assert len({used_rows(row["goals"][..., 8]) for row in rows}) > 1
    with torch.no_grad():
        together = encoder({name: torch.cat([row[name] for row in rows]) for name in rows[0]})
        alone = torch.cat([encoder(row) for row in rows])
    assert torch.allclose(together, alone, rtol=1e-4, atol=1e-4)


def test_surroundings_are_the_means_of_the_cells_inside():
    coarse = torch.rand(2, 8, 24, 24, generator=torch.Generator().manual_seed(0))
    half, wide = tables.surroundings(coarse)
    assert torch.equal(half, torch.nn.functional.avg_pool2d(coarse, 2))
    expected = torch.nn.functional.avg_pool2d(half, 3, 1, 1, count_include_pad=False)
    assert torch.allclose(wide, expected, atol=1e-6)
