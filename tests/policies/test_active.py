"""Explorers that act on their uncertainty, on observations made by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mecp_env.core.errors import ConfigError
from mecp_env.policies.active import (
    AHEAD_M,
    InformationWeights,
    Pause,
    Returning,
    Stachniss,
    Triggers,
    sigma_now,
    sigma_there,
)
from mecp_env.policies.gain import Gain
from mecp_env.policies.registry import GAIN, KIND, LOOK, PATH, PLACE, SIGMA, SIGMA_RAD, WAIT, X, Y
from tests.policies.scenes import UNKNOWN, goal, observation, paint

NEW, NEAR = goal(3.0, 0.0, 3.0), goal(0.0, 2.0, 2.0)


def place(path_m: float, sigma_m: float, gain_nat: float = 0.0) -> dict[int, float]:
    return {X: -path_m, Y: 0.0, PATH: path_m, KIND: PLACE, SIGMA: sigma_m, GAIN: gain_nat}


def scene(*goals: dict[int, float], sigma_m: float = 0.5, recognised: float = 1.0) -> dict[str, Any]:
    """Goals, a position known to `sigma_m` and a heading known well, unknown floor ahead."""
    seen = observation(*goals)
    seen["pose_cov"][:] = [sigma_m**2, 0, 0, sigma_m**2, 0, 1e-8]
    seen["localisation"][2] = recognised
    paint(seen, UNKNOWN, (3.0, 7.0), (-3.0, 3.0))
    return seen


WAITING = {KIND: WAIT}


def test_the_drawing_sigma_has_both_position_and_heading() -> None:
    seen = scene(sigma_m=0.3)
    seen["pose_cov"][5] = 0.1**2
    assert sigma_now(seen["pose_cov"]) == pytest.approx(np.hypot(0.3, AHEAD_M * 0.1))
    rows = observation({SIGMA: 0.3, SIGMA_RAD: 0.1})["goals"][:1]
    assert sigma_there(rows) == pytest.approx([np.hypot(0.3, AHEAD_M * 0.1)])


def test_returning_explores_while_the_pose_is_known_and_returns_when_it_is_not() -> None:
    goals = (NEW, place(8.0, 0.02), place(4.0, 0.05), place(3.0, 0.45))
    assert Returning().act(scene(*goals, sigma_m=0.1)) == 0
    assert Returning(Triggers(metre=0.0)).act(scene(*goals)) == 1  # the best known
    assert Returning(Triggers(metre=0.05)).act(scene(*goals)) == 2  # nearly as good, and nearer


def test_returning_goes_nowhere_for_nothing_and_not_for_ever() -> None:
    assert Returning().act(scene(NEW, place(3.0, 0.45))) == 0
    policy, seen = Returning(Triggers(most_returns=2, between=3)), scene(NEW, place(3.0, 0.05))
    assert [policy.act(seen) for _ in range(7)] == [1, 1, 0, 0, 0, 1, 1]


def test_returning_goes_on_only_when_the_pose_is_clearly_better() -> None:
    policy, goals = Returning(Triggers(lost_m=0.2, share=0.6)), (NEW, place(3.0, 0.05))
    assert policy.act(scene(*goals, sigma_m=0.2)) == 0
    assert policy.act(scene(*goals, sigma_m=0.3)) == 1
    assert policy.act(scene(*goals, sigma_m=0.2)) == 1
    assert policy.act(scene(*goals, sigma_m=0.1)) == 0


def test_returning_does_not_return_for_what_is_uncertain_there_too() -> None:
    """A map whose place is known to 0.3 m only, as wheels slipped at its start."""
    assert Returning().act(scene(NEW, place(3.0, 0.3), sigma_m=0.45)) == 0
    assert Returning().act(scene(NEW, place(3.0, 0.3), sigma_m=0.55)) == 1


def test_returning_does_not_return_while_the_pose_is_known_exactly() -> None:
    seen = scene(NEW, place(3.0, 0.05))
    seen["pose_cov"][:] = 0.0
    assert Returning().act(seen) == 0


def test_pause_waits_a_few_times_where_little_is_recognised() -> None:
    policy = Pause(most_waits=2)
    assert policy.act(scene(NEW, WAITING, recognised=1.0)) == 0
    poor = scene(NEW, WAITING, recognised=0.1)
    assert [policy.act(poor) for _ in range(4)] == [1, 1, 0, 1]
    assert Pause().act(scene(NEW, WAITING, recognised=0.1, sigma_m=0.01)) == 0
    assert Pause().act(scene(NEW, recognised=0.1)) == 0


def test_stachniss_weighs_new_floor_against_the_pose() -> None:
    new = NEW | {SIGMA: 0.1}
    assert Stachniss().act(scene(new, place(4.0, 0.09), sigma_m=0.1)) == 0
    lost = NEW | {SIGMA: 0.9}
    at_home = Stachniss(InformationWeights(pose_nat=1.0, metre_nat=0.4))
    assert at_home.act(scene(lost, place(4.0, 0.05), sigma_m=0.8)) == 1
    assert Stachniss().act(scene(new, NEAR | {SIGMA: 0.1}, sigma_m=0.1)) == 0  # no new floor there, though nearer


def test_a_longer_way_is_worth_less_and_information_more() -> None:
    goals = np.zeros((4, 12))
    goals[:, PATH], goals[:, SIGMA], goals[:, GAIN] = (2.0, 4.0, 2.0, 2.0), (0.1, 0.1, 0.05, 0.1), (0.0, 0.0, 0.0, 2.0)
    worth = Stachniss().utility(np.full(4, 5.0), goals, 0.2)
    assert worth[1] < worth[0] < min(worth[2], worth[3])


@pytest.mark.parametrize("policy", [Pause, Returning, Stachniss])
def test_while_the_pose_is_searched_for_all_look_elsewhere(policy: Any) -> None:
    assert policy().act(scene(NEW, {KIND: LOOK, PATH: 2.0}, WAITING)) == 1


@pytest.mark.parametrize("policy", [Pause, Returning, Stachniss])
def test_without_the_columns_the_policy_says_what_it_needs(policy: Any) -> None:
    seen = scene(NEW)
    del seen["localisation"]
    with pytest.raises(
        ConfigError, match=rf"{policy.__name__} reads `localisation`, the observation has goals.*uncertainty"
    ):
        policy().act(seen)


@pytest.mark.parametrize("policy", [Gain, Pause, Returning, Stachniss])
def test_rows_that_are_masked_are_not_chosen(policy: Any) -> None:
    mask = np.ones(32, bool)
    mask[1:4] = False
    seen = scene(NEW, place(3.0, 0.01), WAITING, {KIND: LOOK}, recognised=0.0)
    assert policy().act(seen, mask) == 0
