"""What an agent is, and what the columns of its observation are called."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_] | None

X, Y, PATH, SIZE, KIND, ROOM, LEVEL, VISITS, VALID = range(9)  # columns of `goals`
KINDS = ("open edge", "door candidate", "frontier", "door")


class Agent(Protocol):
    """A policy: it sees the observation and nothing else."""

    actions: str  # the action mode that it wants of the environment: "goal", "velocity" or "discrete"

    def reset(self, seed: int = 0) -> None:
        """Begin an episode; all that is random in it follows from `seed`."""

    def act(self, observation: dict[str, Any], mask: Mask = None) -> Any:
        """An action of that mode; `mask` (32,) bars rows of `goals`, None where there is no choice of goals."""


def choices(observation: dict[str, Any], mask: Mask = None) -> NDArray[np.int64]:
    """(k,) the rows of the observation's goals that may be chosen."""
    valid = np.asarray(observation["goals"])[:, VALID] > 0.5
    return np.flatnonzero(valid if mask is None else valid & np.asarray(mask, np.bool_))
