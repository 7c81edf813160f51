"""The policy on scripted tables of goals."""

import numpy as np
import pytest

from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.planning.goals import GoalKind

OPEN, CANDIDATE, FRONTIER, DOOR, *_ = GoalKind


def table(*goals: tuple[GoalKind, int, int, float]) -> dict[str, np.ndarray]:
    """Observation with goals of kind, room, level, path length, and nothing else."""
    rows = np.zeros((32, 9), np.float32)
    for row, (kind, room, level, path) in zip(rows, goals, strict=False):
        row[[2, 4, 5, 6, 8]] = path, kind, room, level, 1.0
    return {"goals": rows}


@pytest.mark.parametrize(
    ("goals", "order"),
    [
        ([(FRONTIER, 2, 3, 30.0), (DOOR, 2, 0, 1.0)], [0, 1]),
        ([(OPEN, 2, 1, 1.0), (OPEN, 2, 0, 9.0), (OPEN, 2, 1, 0.5)], [1, 2, 0]),  # nearest level, then shortest way
        ([(DOOR, 5, 2, 1.0), (DOOR, 0, 0, 20.0), (DOOR, 3, 1, 3.0), (DOOR, 4, 1, 2.0)], [1, 3, 2, 0]),
        ([(DOOR, 1, 0, 1.0), (OPEN, 7, 1, 12.0), (OPEN, 7, 0, 13.0), (OPEN, 4, 0, 14.0)], [2, 1, 3, 0]),  # left early
        ([(OPEN, 1, 0, 2.0), (CANDIDATE, 1, 1, 1.0), (FRONTIER, 1, 0, 1.0), (DOOR, 1, 1, 3.0)], [2, 0, 1, 3]),
    ],
)
def test_the_room_is_completed_before_a_door(goals: list[tuple[GoalKind, int, int, float]], order: list[int]) -> None:
    """Rooms breadth-first over the door graph; each goal disappears by being visited."""
    policy, left = BreadthFirst(), list(range(len(goals)))
    policy.reset()
    for row in order:
        assert left.pop(policy.act(table(*(goals[i] for i in left)))) == row


def test_barred_and_empty_rows_are_never_chosen() -> None:
    observation, mask = table((OPEN, 0, 0, 1.0), (OPEN, 0, 0, 2.0)), np.ones(32, np.bool_)
    assert BreadthFirst().act(observation, mask) == 0
    mask[0] = False
    assert BreadthFirst().act(observation, mask) == 1
    assert BreadthFirst().act(table()) == BreadthFirst().act(table(), np.zeros(32, np.bool_)) == 0
