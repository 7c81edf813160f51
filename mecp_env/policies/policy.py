"""The interface of a policy, and the columns of its observation."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from mecp_env.core.array_types import Bools, Ints

Mask = Bools | None

X, Y, PATH, SIZE, KIND, ROOM, LEVEL, VISITS, VALID = range(9)  # columns of `goals`
SIGMA, SIGMA_RAD, GAIN = 9, 10, 11  # of those with `uncertainty`
KINDS = ("open edge", "door candidate", "frontier", "door", "place", "wait", "look")
PLACE, WAIT, LOOK = 4, 5, 6


class Policy(Protocol):
    """Maps observations to actions; it receives the observation and nothing else."""

    actions: str  # the action mode that it needs of the environment: "goal", "velocity" or "discrete"

    def reset(self, seed: int = 0) -> None:
        """Start an episode; all randomness in it follows from `seed`."""

    def act(self, observation: dict[str, Any], mask: Mask = None) -> Any:
        """An action of that mode; `mask` (32,) excludes rows of `goals`, None for other actions."""


def choices(observation: dict[str, Any], mask: Mask = None) -> Ints:
    """(k,) the rows of the observation's goals that have something left to see and may be selected."""
    goals = np.asarray(observation["goals"])
    return _allowed((goals[:, VALID] > 0.5) & (goals[:, KIND] < PLACE), mask)


def of_kind(kind: int, observation: dict[str, Any], mask: Mask = None) -> Ints:
    """(k,) the rows of that kind that may be selected."""
    goals = np.asarray(observation["goals"])
    return _allowed((goals[:, VALID] > 0.5) & (goals[:, KIND] == kind), mask)


def _allowed(valid: Bools, mask: Mask) -> Ints:
    return np.flatnonzero(valid if mask is None else valid & np.asarray(mask, np.bool_))
