"""The explorers, and those that act on their uncertainty, on observations made by hand."""

from typing import Any

import numpy as np
import pytest

from mecp_env.core.errors import ConfigError
from mecp_env.planning.goal_list import AHEAD_M
from mecp_env.policies import registry
from mecp_env.policies.active import InformationWeights, Pause, Returning, Stachniss, Triggers, sigma_now, sigma_there
from mecp_env.policies.explorers import Gain, Nearest, RandomGoal, Weights, unseen_area, well_known
from mecp_env.policies.registry import EXPLORERS, GAIN, KIND, LOOK, PATH, PLACE, SIGMA, SIGMA_RAD, VALID, WAIT, X, Y
from tests.policies.scenes import OCCUPIED, UNKNOWN, goal, landmarks, observation, paint

DOOR = 3
NEW, NEAR, WAITING = goal(3.0, 0.0, 3.0), goal(0.0, 2.0, 2.0), {KIND: WAIT}


def bar(*rows: int) -> np.ndarray:
    mask = np.ones(32, bool)
    mask[list(rows)] = False
    return mask


@pytest.mark.parametrize("name", EXPLORERS)
def test_every_explorer_chooses_among_the_goals_begins_anew_and_changes_nothing(name: str) -> None:
    policy = registry.make_policy(name)
    seen = observation(goal(1, 0, 4.0), goal(2, 0, 3.0), goal(3, 0, 5.0))
    before = {part: values.copy() for part, values in seen.items()}
    policy.reset(7)
    first = [policy.act(seen, bar(1)) for _ in range(30)]
    policy.reset(7)
    assert np.array_equal(first, [policy.act(seen, bar(1)) for _ in range(30)])
    if policy.actions == "goal":
        assert set(first) <= {0, 2}
        assert policy.act(observation(), np.zeros(32, bool)) == 0
    assert all(np.array_equal(before[part], seen[part]) for part in seen)


def test_nearest_goes_by_the_way_and_not_by_the_line_and_only_to_goals() -> None:
    seen = observation(goal(0.5, 0, 9.0), goal(5, 0, 6.0), goal(0, 2, 7.0))
    assert Nearest().act(seen) == 1
    assert Nearest().act(seen, bar(1)) == 2
    seen = observation(goal(0, 0, 0.0), goal(5, 0, 6.0))
    seen["goals"][0, VALID] = 0.0
    assert Nearest().act(seen) == Gain().act(seen) == RandomGoal().act(seen) == 1


def test_random_goals_are_drawn_evenly() -> None:
    policy, seen = RandomGoal(), observation(*(goal(x, 0, x) for x in range(1, 5)))
    counts = np.bincount([policy.act(seen, bar(2)) for _ in range(3000)], minlength=4)
    assert counts[2] == 0
    assert np.all(np.abs(counts[[0, 1, 3]] - 1000) < 4 * np.sqrt(3000 * 2 / 9))


def test_the_unseen_area_is_that_of_the_disc_in_sight() -> None:
    seen = observation()
    paint(seen, UNKNOWN, (-9.6, 9.6), (-9.6, 9.6))
    area = unseen_area(seen["grid"], np.array([[0.0, 0.0], [1.0, 1.0]]), 3.0)
    assert area == pytest.approx(np.pi * 9.0, rel=0.01)


def test_a_wall_hides_what_lies_behind_it() -> None:
    seen = observation()
    paint(seen, UNKNOWN, (2.0, 6.0), (-9.0, 9.0))
    place = np.array([[0.0, 0.0]])
    before = unseen_area(seen["grid"], place, 5.0)[0]
    paint(seen, OCCUPIED, (1.6, 1.8), (0.0, 9.0))  # the left half
    after = unseen_area(seen["grid"], place, 5.0)[0]
    assert after == pytest.approx(before / 2, rel=0.05)
    known = unseen_area(seen["grid"], np.array([[-4.0, 0.0]]), 5.0)[0]
    assert known == 0.0


def test_nothing_is_expected_outside_of_the_grid_but_behind_doors() -> None:
    seen = observation(goal(12, 0, 14.0, kind=DOOR), goal(12, 3, 14.0), goal(1, 0, 1.0))
    area = Gain().expected_area(seen["grid"], seen["goals"][:3].astype(float))
    assert area.tolist() == [Weights().beyond_m2, 0.0, 0.0]


def test_gain_prefers_much_floor_to_a_short_way_but_not_at_any_price() -> None:
    seen = observation(goal(2, 0, 2.0), goal(-4, 0, 4.0))
    paint(seen, UNKNOWN, (-9.0, -4.0), (-4.0, 4.0))
    paint(seen, UNKNOWN, (2.0, 2.6), (-0.6, 0.6))
    assert Nearest().act(seen) == 0
    assert Gain().act(seen) == 1
    seen["goals"][1, 2] = 190.0
    assert Gain().act(seen) == 0
    seen = observation(goal(2, 0, 3.0), goal(-2, 0, 2.0))  # where nothing new is expected, it goes to the nearest
    paint(seen, UNKNOWN, (2.0, 2.2), (0.0, 0.2))
    assert Gain().act(seen) == 1


def test_gain_looks_one_goal_ahead() -> None:
    seen = observation(goal(3, 0, 3.0), goal(-3, 0, 3.0), goal(-4, 2, 4.5))
    paint(seen, UNKNOWN, (3.0, 5.0), (-1.0, 1.0))
    paint(seen, UNKNOWN, (-5.0, -3.0), (-0.9, 0.9))
    paint(seen, UNKNOWN, (-5.0, -3.0), (2.0, 3.0))
    area = Gain().expected_area(seen["grid"], seen["goals"][:3].astype(float))
    goals = seen["goals"][:3].astype(float)
    assert Gain().value_of(area, goals).argmax() == 1
    alone = Gain(Weights(winding=1e9)).value_of(area, goals)
    assert alone == pytest.approx(area**0.7 / (goals[:, 2] + 2.0))


def test_an_unsure_robot_prefers_ground_that_it_knows() -> None:
    seen = observation(goal(5, 0, 5.0), goal(-5, 0, 5.0))
    for side in (-1, 1):
        paint(seen, UNKNOWN, tuple(sorted((side * 5.0, side * 8.0))), (-2.0, 2.0))
    paint(seen, UNKNOWN, (8.0, 8.4), (-2.0, 2.0))  # a little more ahead
    landmarks(seen, [(-5, 1), (-5, -1), (-6, 0)], 0.01)
    assert Gain().act(seen) == 0
    seen["pose_cov"][[0, 3]] = 0.2**2
    assert Gain().act(seen) == 1
    assert Gain(Weights(caution=0.0)).act(seen) == 0


def test_ground_is_known_by_landmarks_that_are_surer_than_the_pose() -> None:
    seen = observation()
    landmarks(seen, [(0, 1), (0, 2), (0, -3), (9, 0)], 0.04)
    places = np.array([[0.0, 0.0], [9.0, 0.0], [-9.0, 0.0]])
    assert well_known(seen["landmarks"], places, 0.1).tolist() == pytest.approx([1.0, 1 / 3, 0.0])
    assert well_known(seen["landmarks"], places, 0.05).tolist() == [0.0, 0.0, 0.0]


def place(path_m: float, sigma_m: float, gain_nat: float = 0.0) -> dict[int, float]:
    return {X: -path_m, Y: 0.0, PATH: path_m, KIND: PLACE, SIGMA: sigma_m, GAIN: gain_nat}


def scene(*goals: dict[int, float], sigma_m: float = 0.5, recognised: float = 1.0) -> dict[str, Any]:
    """Goals, a position known to `sigma_m` and a heading known well, unknown floor ahead."""
    seen = observation(*goals)
    seen["pose_cov"][:] = [sigma_m**2, 0, 0, sigma_m**2, 0, 1e-8]
    seen["localisation"][2] = recognised
    paint(seen, UNKNOWN, (3.0, 7.0), (-3.0, 3.0))
    return seen


def test_the_drawing_sigma_has_both_position_and_heading() -> None:
    seen = scene(sigma_m=0.3)
    seen["pose_cov"][5] = 0.1**2
    assert sigma_now(seen["pose_cov"]) == pytest.approx(np.hypot(0.3, AHEAD_M * 0.1))
    rows = observation({SIGMA: 0.3, SIGMA_RAD: 0.1})["goals"][:1]
    assert sigma_there(rows) == pytest.approx([np.hypot(0.3, AHEAD_M * 0.1)])


GOALS = (NEW, place(8.0, 0.02), place(4.0, 0.05), place(3.0, 0.45))
EXACT = scene(NEW, place(3.0, 0.05))
EXACT["pose_cov"][:] = 0.0
AT_HOME = Stachniss(InformationWeights(pose_nat=1.0, metre_nat=0.4))
CHOICES: dict[str, tuple[Any, dict[str, Any], int]] = {
    "returning explores while the pose is known": (Returning(), scene(*GOALS, sigma_m=0.1), 0),
    "returning takes the best known place": (Returning(Triggers(metre=0.0)), scene(*GOALS), 1),
    "returning takes one nearly as good and nearer": (Returning(Triggers(metre=0.05)), scene(*GOALS), 2),
    "returning does not go where little is gained": (Returning(), scene(NEW, place(3.0, 0.45)), 0),
    "returning does not go where the map is uncertain too": (Returning(), scene(NEW, place(3.0, 0.3), sigma_m=0.45), 0),
    "returning goes where the map is clearly better": (Returning(), scene(NEW, place(3.0, 0.3), sigma_m=0.55), 1),
    "returning explores with a pose known exactly": (Returning(), EXACT, 0),
    "pause drives where much is recognised": (Pause(), scene(NEW, WAITING, recognised=1.0), 0),
    "pause drives with a pose known well": (Pause(), scene(NEW, WAITING, recognised=0.1, sigma_m=0.01), 0),
    "pause drives where waiting is not offered": (Pause(), scene(NEW, recognised=0.1), 0),
    "stachniss explores": (Stachniss(), scene(NEW | {SIGMA: 0.1}, place(4.0, 0.09), sigma_m=0.1), 0),
    "stachniss returns": (AT_HOME, scene(NEW | {SIGMA: 0.9}, place(4.0, 0.05), sigma_m=0.8), 1),
    "stachniss passes a nearer goal without new floor": (
        Stachniss(), scene(NEW | {SIGMA: 0.1}, NEAR | {SIGMA: 0.1}, sigma_m=0.1), 0,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CHOICES)
def test_uncertainty_decides_between_new_floor_and_known_ground(name: str) -> None:
    policy, seen, row = CHOICES[name]
    assert policy.act(seen) == row


def test_returning_goes_on_only_when_the_pose_is_clearly_better_and_not_for_ever() -> None:
    policy, goals = Returning(Triggers(lost_m=0.2, share=0.6)), (NEW, place(3.0, 0.05))
    assert [policy.act(scene(*goals, sigma_m=sigma_m)) for sigma_m in (0.2, 0.3, 0.2, 0.1)] == [0, 1, 1, 0]
    policy, seen = Returning(Triggers(most_returns=2, between=3)), scene(*goals)
    assert [policy.act(seen) for _ in range(7)] == [1, 1, 0, 0, 0, 1, 1]


def test_pause_waits_a_few_times_where_little_is_recognised() -> None:
    policy, poor = Pause(most_waits=2), scene(NEW, WAITING, recognised=0.1)
    assert [policy.act(poor) for _ in range(4)] == [1, 1, 0, 1]


def test_a_longer_way_is_worth_less_and_information_more() -> None:
    goals = np.zeros((4, 12))
    goals[:, PATH], goals[:, SIGMA], goals[:, GAIN] = (2.0, 4.0, 2.0, 2.0), (0.1, 0.1, 0.05, 0.1), (0.0, 0.0, 0.0, 2.0)
    worth = Stachniss().utility(np.full(4, 5.0), goals, 0.2)
    assert worth[1] < worth[0] < min(worth[2], worth[3])


@pytest.mark.parametrize("policy", [Gain, Pause, Returning, Stachniss])
def test_masked_rows_a_lost_pose_and_columns_that_are_needed(policy: Any) -> None:
    mask = np.ones(32, bool)
    mask[1:4] = False
    seen = scene(NEW, place(3.0, 0.01), WAITING, {KIND: LOOK}, recognised=0.0)
    assert policy().act(seen, mask) == 0
    if policy is not Gain:
        assert policy().act(scene(NEW, {KIND: LOOK, PATH: 2.0}, WAITING)) == 1  # while the pose is searched for
        del seen["localisation"]
        said = rf"{policy.__name__} reads `localisation`, the observation has goals.*uncertainty"
        with pytest.raises(ConfigError, match=said):
            policy().act(seen)
