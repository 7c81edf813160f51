"""The tasks of active SLAM: rows of known ground and waiting, the columns of uncertainty, and lost episodes."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from mecp_env.core.errors import ConfigError
from mecp_env.episode.tasks import TASKS
from mecp_env.policies.registry import GAIN, LOOK, PATH, PLACE, SIGMA, SIGMA_RAD, VALID, WAIT, choices, of_kind
from tests.env.helpers import episode_of, same, until_over

HALLS = "mecp_env/ActiveHalls-v0"


def make(task: str = HALLS, **keywords: Any) -> gymnasium.Env:
    return gymnasium.make(task, disable_env_checker=True, **keywords)


def explored(env: gymnasium.Env, decisions: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """Observation and info after that many drives to the nearest goal."""
    observation, info = env.reset(seed=0, options={"building": 0})
    for _ in range(decisions):
        rows = choices(observation)
        row = rows[observation["goals"][rows, PATH].argmin()]
        observation, *_, info = env.step(int(row))
    return observation, info


@pytest.mark.parametrize("name", TASKS)
def test_a_task_is_an_environment_with_goals_and_uncertainty(name: str) -> None:
    env = make(f"mecp_env/{name}")
    observation, _ = env.reset(seed=3)
    assert observation["goals"].shape == (32, 12)
    assert observation["localisation"].tolist() == pytest.approx([1.0, 1.0, 0.0], abs=0.05)
    assert env.unwrapped.config.max_steps == 1500
    for _ in range(3):
        observation, *_ = env.step(int(observation["goals"][:, VALID].argmax()))
        assert env.observation_space.contains(observation)
    assert observation["localisation"][2] > 0.0


def test_fields_of_a_task_are_overridden_one_by_one() -> None:
    config = make(laser={"beams": 360}, reward={"lost_share": -0.2}, rooms=4).unwrapped.config
    assert (config.laser.beams, config.laser.max_range_m) == (360, 2.5)
    assert (config.reward.lost_share, config.reward.correct_coverage, config.reward.coverage) == (-0.2, 1.0, 0.0)
    assert config.layout["generate"]["rooms"] == 4
    assert config.layout["generate"]["loops"] == 2
    assert make(observation="flat").observation_space.shape == (421,)  # with the columns of uncertainty
    with pytest.raises(ConfigError, match="romms"):
        make(romms=4)
    first = make("mecp_env/First-v0")  # small and flat
    assert isinstance(first.observation_space, spaces.Box)
    assert first.action_space == spaces.Discrete(5)
    assert first.unwrapped.config.layout["generate"]["difficulty"] == "easy"


def test_places_can_be_driven_to_have_predictions_and_continue_bit_for_bit() -> None:
    env, other = make(), make()
    observation, _ = explored(env, 12)
    rows = observation["goals"][observation["goals"][:, VALID] > 0.5]
    assert ((rows[:, [SIGMA, SIGMA_RAD]] > 0.0) & (rows[:, [SIGMA, SIGMA_RAD]] < 1.0)).all()
    assert (rows[:, GAIN] >= 0.0).all()
    place = of_kind(PLACE, observation)[0]
    there = env.unwrapped.goals.p_map[place]
    other.reset(seed=9)
    other.unwrapped.set_state(env.unwrapped.get_state())
    row = env.step(int(place))
    assert same(row, other.step(int(place)))
    assert row[-1]["event"] == "reached"
    assert np.hypot(*(env.unwrapped.slam_output.belief.T_map_robot[:2] - there)) < 1.0


def test_waiting_takes_its_steps_and_keeps_the_robot_where_it_is() -> None:
    env = make()
    observation, info = explored(env, 4)
    before, metres = info["period"], info["metres"]
    observation, reward, _, _, info = env.step(int(of_kind(WAIT, observation)[0]))
    assert (info["event"], info["periods"], info["period"]) == ("waited", 5, before + 5)
    assert info["metres"] == pytest.approx(metres, abs=0.5)  # until it stands
    assert reward == pytest.approx(0.0, abs=0.02)
    assert len(of_kind(WAIT, observation)) == 1


def test_a_lost_robot_pays_at_the_end_for_what_is_not_in_its_place() -> None:
    env = make(max_steps=3, reward="active_terms")
    env.reset(seed=0, options={"building": 0})
    episode_of(env).pipeline.filter.shift_pose(np.array([3.0, 0.0, 0.0]))
    *_, (*_, info) = until_over(env, lambda _: int(env.unwrapped.goals.kind.tolist().index(WAIT)))
    figures = env.unwrapped.summary()
    misplaced = (figures["coverage"] - figures["correct_coverage"]) * figures["free_area_m2"]
    assert info["lost"] is True
    assert misplaced > 1.0
    assert info["reward_lost"] == pytest.approx(-5.0 * (1.0 + misplaced / 20.0))


def unlocalised(env: gymnasium.Env) -> dict[str, Any]:
    """The observation after a drive during which the filter lost the pose."""
    (observation, info), pipeline = explored(env, 8), episode_of(env).pipeline
    for _ in range(40):
        if info["event"] == "unlocalised":
            return observation
        if pipeline.guard.localised:
            pipeline.filter.shift_pose(np.array([0.9, -0.7, 0.5]))
        observation, *_, info = env.step(int(observation["goals"][:, VALID].argmax()))
    raise AssertionError("the pose was never searched for")


def test_a_drive_ends_when_the_pose_is_searched_for_and_open_floor_is_offered() -> None:
    env = make("mecp_env/ActiveCheapRobot-v0")
    observation = unlocalised(env)
    assert observation["localisation"][1] == 0.0
    assert not len(of_kind(PLACE, observation))
    look = of_kind(LOOK, observation)
    before = env.unwrapped.view().T_world_robot[:2].copy()
    *_, info = env.step(int(look[0]))
    assert info["event"] in ("reached", "refused")
    moved = np.hypot(*(env.unwrapped.view().T_world_robot[:2] - before))
    assert moved > 0.3 or info["localised"]
