"""A recorded policy sees what it was made for, whatever the dataset keeps (no Minari is needed for that)."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

import pytest

from mecp_env.policies.recording import Recording
from mecp_env.policies.setting import Setting


class FlatDriver:
    """Drives ahead; it takes nothing but flat observations."""

    actions, settings = "discrete", MappingProxyType({"observation": "flat"})

    def reset(self, seed: int = 0) -> None:
        """Nothing to do."""

    def act(self, observation: Any, mask: Any = None) -> int:
        """Ahead."""
        assert observation.ndim == 1
        return 1


class MapReader(FlatDriver):
    """The same with the tables and the coarse map."""

    settings = MappingProxyType({"observation": {"map": True}})

    def act(self, observation: Any, mask: Any = None) -> int:
        """Ahead."""
        return int(observation["map"].shape == (8, 64, 64))


@pytest.mark.parametrize("policy", [FlatDriver(), MapReader()])
@pytest.mark.parametrize("observation", ["dict", "flat"])
def test_a_policy_sees_the_format_that_it_needs_whatever_is_recorded(policy: Any, observation: str) -> None:
    setting = Setting("easy", "validation", "slam", 3)
    rows = next(iter(Recording(policy, setting, observation).episodes(0, 1)))
    assert rows.actions == [1, 1, 1]
    assert isinstance(rows.observations[0], dict) == (observation == "dict")
