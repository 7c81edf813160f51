"""What is published with a release, as far as it can be checked without the tools of the extra `publish`."""

import hashlib
import json

import gymnasium
import yaml

import mecp_env  # noqa: F401  (registers the environments)
from mecp_env.policies.suites import SUITES
from tests.command_lines import ROOT

PUBLISHING = ROOT / "publishing"


DESCRIBED = json.loads((PUBLISHING / "croissant.json").read_text())


def test_the_dataset_description_has_the_frozen_benchmarks_of_this_version() -> None:
    named = {part["name"]: part["data"] for part in DESCRIBED["recordSet"]}
    assert [record["splits/name"] for record in named["splits"]] == ["train", "validation", "test"]
    expected = [
        (name, setting.name, setting.split, suite.episodes, setting.max_steps, suite.frozen)
        for name, suite in SUITES.items()
        for setting in suite.settings
        if name in ("active-v1", "coverage-v1")
    ]
    columns = [f"suites/{name}" for name in ("suite", "setting", "split", "buildings", "max_steps", "hash")]
    assert [tuple(record[column] for column in columns) for record in named["suites"]] == expected


def test_the_described_files_are_those_in_the_package() -> None:
    files = {part["@id"]: part for part in DESCRIBED["distribution"]}
    assert set(files) == {"active-v1.json", "coverage-v1.json"}
    for part in files.values():
        assert hashlib.sha256((ROOT / part["contentUrl"]).read_bytes()).hexdigest() == part["sha256"]


def test_the_hyperparameters_of_the_zoo_name_environments_of_flat_vectors() -> None:
    named = yaml.safe_load((PUBLISHING / "rl_zoo3.yml").read_text())
    for env_id in ("mecp_env/First-v0", "mecp_env/Rooms-v0", "mecp_env/ActiveHalls-v0"):
        env = gymnasium.make(env_id, **named[env_id].get("env_kwargs", {}))
        assert isinstance(env.observation_space, gymnasium.spaces.Box)
        assert isinstance(env.action_space, gymnasium.spaces.Discrete)
