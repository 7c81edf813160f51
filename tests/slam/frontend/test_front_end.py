"""The front end in one compiled call gives the bits of its stages one by one."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from mecp_env.slam.config import SlamConfig
from mecp_env.slam.frontend import front_end as module
from mecp_env.slam.frontend.front_end import front_end, stage_by_stage
from tests.slam.scans import LMS200, PAPER, ROOM, blank_scan, take_scan

RULES: tuple[dict[str, Any], ...] = (
    {},
    {"clustering": {"threshold": "fixed"}},
    {"clustering": {"threshold": "adaptive"}},
    {"corners": {"covariance": "sensor"}},
)


def bits(value: Any) -> Any:
    """What is in a carrier."""
    if dataclasses.is_dataclass(value):
        return [bits(getattr(value, part.name)) for part in dataclasses.fields(value)]
    return (value.dtype, value.shape, value.tobytes()) if isinstance(value, np.ndarray) else value


@pytest.mark.parametrize("rules", RULES)
@pytest.mark.parametrize("sweeps", [1, 2, 4])
def test_one_call_gives_the_bits_of_the_stages(rules: dict[str, Any], sweeps: int) -> None:
    config = SlamConfig(**rules, sensor=PAPER)
    for scan in (*(take_scan(ROOM, PAPER, seed, sweeps) for seed in range(5)), blank_scan(sweeps)):
        assert bits(front_end(scan, config)) == bits(stage_by_stage(scan, config))


@pytest.mark.parametrize(
    ("fields", "calls"),
    [
        ({"sensor": PAPER}, 1),
        ({"sensor": LMS200}, None),
        ({"sensor": PAPER, "clustering": {"sweeps": "union"}}, 0),
    ],
)
def test_lasers_that_lose_beams_and_unions_take_the_stages(
    monkeypatch: pytest.MonkeyPatch, fields: dict[str, Any], calls: int | None
) -> None:
    called, real = list[None](), module.find_features
    monkeypatch.setattr(module, "find_features", lambda *args: called.append(None) or real(*args))
    config = SlamConfig(**fields)
    front_end(take_scan(ROOM, PAPER), config)
    loses = config.sensor.dark_dropout > 0.0 or config.sensor.grazing_deg < 90.0
    assert len(called) == (int(not loses) if calls is None else calls)
