"""The interface of a policy, and the columns of its observation."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from mecp_env.core.array_types import Bools, Ints

Mask = Bools | None

X, Y, PATH, SIZE, KIND, ROOM, LEVEL, VISITS, VALID = range(9)  # columns of `goals`
KINDS = ("open edge", "door candidate", "frontier", "door")


class Policy(Protocol):
    """Maps observations to actions; it receives the observation and nothing else."""

    actions: str  # the action mode that it needs of the environment: "goal", "velocity" or "discrete"

    def reset(self, seed: int = 0) -> None:
        """Start an episode; all randomness in it follows from `seed`."""

    def act(self, observation: dict[str, Any], mask: Mask = None) -> Any:
        """An action of that mode; `mask` (32,) excludes rows of `goals`, None for other actions."""


def choices(observation: dict[str, Any], mask: Mask = None) -> Ints:
    """(k,) the rows of the observation's goals that may be selected."""
    valid = np.asarray(observation["goals"])[:, VALID] > 0.5
    return np.flatnonzero(valid if mask is None else valid & np.asarray(mask, np.bool_))
