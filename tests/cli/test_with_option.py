"""`--with`: parts that a module of the user registers, in commands and in the processes that they start."""

import json
from pathlib import Path

import pytest

from mecp_env.cli import main as cli
from mecp_env.slam.config import METHODS

PARTS = """
from mecp_env.episode.potentials import register_reward
from mecp_env.policies.registry import register_policy
from mecp_env.slam.association import register_associator
from mecp_env.slam.association.mecp import MecpAssociator


class Own(MecpAssociator):
    pass


register_associator("own_associator", Own)
register_reward("landmarks_seen", lambda inputs: float(len(inputs.belief.ids)))
register_policy("own_policy", "mecp_env.policies.explorers:Nearest")
"""
OWN = ["--with", "own_parts_of_a_test", "--env.slam.association.method", "own_associator"]
WEIGHT = ["--env.reward.custom", "landmarks_seen", "1"]

Captured = pytest.CaptureFixture[str]


@pytest.fixture
def parts(own_parts: Path) -> Path:
    """A module of the user in the working directory."""
    file = own_parts / "own_parts_of_a_test.py"
    file.write_text(PARTS)
    return file


@pytest.mark.slow
@pytest.mark.usefixtures("parts")
def test_policy_associator_and_reward_of_a_module_are_evaluated_in_other_processes() -> None:
    line = ["own_policy", "--layout", "two_rooms", "--episodes", "2", "--no-truth", "--jobs", "2", "--max-steps", "30"]
    assert cli.main(["evaluate", *line, "--reference", "own_policy", *OWN, *WEIGHT, "--out", "runs"]) == 0
    result = json.loads(Path("runs/results.json").read_text())
    assert result["setting"]["env"]["slam"]["association"]["method"] == "own_associator"
    assert result["rows"][0]["figures"]["reward"]["value"] > 3.0  # of landmarks


def test_episodes_of_another_module_are_refused(parts: Path, capsys: Captured) -> None:
    line = ["evaluate", "nearest", "--layout", "two_rooms", "--episodes", "1", "--no-truth", "--max-steps", "5"]
    assert cli.main([*line, *OWN, "--out", "runs"]) == 0
    assert "own_associator" in METHODS.others
    parts.write_text(PARTS + "\n# changed\n")
    assert cli.main([*line, *OWN, "--out", "runs"]) == 2
    assert "module own_parts_of_a_test" in capsys.readouterr().err
