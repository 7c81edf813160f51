"""Options that stand for fields of a configuration."""

import pytest

from mecp_env.cli.base import Line
from mecp_env.cli.options import with_reward_preset

WEIGHT = ["--env.reward.completion", "1"]


@pytest.mark.parametrize("weight", [WEIGHT, ["--config.reward.a-optimality=2"]])
def test_weights_of_the_reward_without_a_preset_stand_for_terms(weight: list[str]) -> None:
    prefix = weight[0].rpartition(".")[0]
    assert with_reward_preset(Line(["ppo", *weight])) == ("ppo", *weight, f"{prefix}.preset", "terms")


@pytest.mark.parametrize("line", [["ppo"], ["--env.reward.custom", "own", "1"], ["--env.reward.source", "truth"]])
def test_without_weights_the_preset_stays(line: list[str]) -> None:
    assert with_reward_preset(Line(line)) == tuple(line)
