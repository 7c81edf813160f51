"""The policy on scripted tables of goals."""

from __future__ import annotations

import numpy as np
import pytest

from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.planning.goals import GoalKind

OPEN, CANDIDATE, FRONTIER, DOOR, *_ = GoalKind


def table(*goals: tuple[GoalKind, int, int, float]) -> dict[str, np.ndarray]:
    """Observation with goals of kind, room, level, path length."""
    rows = np.zeros((32, 9), np.float32)
    for row, (kind, room, level, path) in zip(rows, goals, strict=False):
        row[[2, 4, 5, 6, 8]] = path, kind, room, level, 1.0
    return {"goals": rows}


def order(*goals: tuple[GoalKind, int, int, float]) -> list[int]:
    """The order in which goals are chosen when each disappears by being visited."""
    policy, left, chosen = BreadthFirst(), list(range(len(goals))), []
    policy.reset()
    while left:
        chosen.append(left[policy.act(table(*(goals[i] for i in left)))])
        left.remove(chosen[-1])
    return chosen


def test_nearest_level_first_then_the_shortest_way() -> None:
    assert order((OPEN, 2, 1, 1.0), (OPEN, 2, 0, 9.0), (OPEN, 2, 1, 0.5)) == [1, 2, 0]


def test_the_room_is_completed_before_a_door() -> None:
    assert order((FRONTIER, 2, 3, 30.0), (DOOR, 2, 0, 1.0)) == [0, 1]


def test_rooms_breadth_first_over_the_door_graph() -> None:
    assert order((DOOR, 5, 2, 1.0), (DOOR, 0, 0, 20.0), (DOOR, 3, 1, 3.0), (DOOR, 4, 1, 2.0)) == [1, 3, 2, 0]


def test_a_room_left_early_is_completed_before_a_new_one() -> None:
    assert order((DOOR, 1, 0, 1.0), (OPEN, 7, 1, 12.0), (OPEN, 7, 0, 13.0), (OPEN, 4, 0, 14.0)) == [2, 1, 3, 0]


def test_a_whole_episode_in_order() -> None:
    goals = [(OPEN, 1, 0, 2.0), (CANDIDATE, 1, 1, 1.0), (FRONTIER, 1, 0, 1.0), (DOOR, 1, 1, 3.0), (DOOR, 0, 0, 8.0)]
    assert order(*goals) == [2, 0, 1, 4, 3]


def test_barred_and_empty_rows_are_never_chosen() -> None:
    observation = table((OPEN, 0, 0, 1.0), (OPEN, 0, 0, 2.0))
    mask = np.ones(32, np.bool_)
    assert BreadthFirst().act(observation, mask) == 0
    mask[0] = False
    assert BreadthFirst().act(observation, mask) == 1
    assert BreadthFirst().act(table()) == 0
    assert BreadthFirst().act(table(), np.zeros(32, np.bool_)) == 0


@pytest.mark.parametrize("key", ["info", "grid", "landmarks"])
def test_nothing_but_the_goals_is_read(key: str) -> None:
    class Guarded(dict[str, np.ndarray]):
        def __getitem__(self, name: str) -> np.ndarray:
            assert name != key
            return super().__getitem__(name)

    assert BreadthFirst().act(Guarded(table((DOOR, 0, 0, 1.0)))) == 0
