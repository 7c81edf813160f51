"""What an installation contains, and what is published with a release, as far as it needs no tools of `publish`."""

import hashlib
import importlib
import json
import subprocess
import sys
import tomllib
import zipfile
from importlib.util import find_spec
from pathlib import Path

import gymnasium
import pytest
import yaml
from packaging.requirements import Requirement
from packaging.version import Version

import mecp_env  # noqa: F401  (registers the environments)
from mecp_env.policies.suites import SUITES
from tests.command_lines import ROOT

PUBLISHING = ROOT / "publishing"
DESCRIBED = json.loads((PUBLISHING / "croissant.json").read_text())


def test_the_wheel_contains_weights_and_layouts_and_nothing_but_the_package(tmp_path: Path) -> None:
    wheel = pytest.importorskip("hatchling.builders.wheel")
    path = next(wheel.WheelBuilder(str(ROOT)).build(directory=str(tmp_path), versions=["standard"]))
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    assert {name.partition("/")[0].partition("-")[0] for name in names} == {"mecp_env"}
    assert any(name.startswith("mecp_env/learning/weights/maskable_ppo/policy-") for name in names)
    for suffix in (".json", ".py", ".typed"):
        below = [path for path in (ROOT / "mecp_env").rglob(f"*{suffix}") if path.name[:1] != "."]
        assert not [path for path in below if str(path.relative_to(ROOT)) not in names]


def test_the_adapter_without_its_extra_names_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "stable_baselines3.common.env_util", None)
    monkeypatch.delitem(sys.modules, "mecp_env.learning.sb3_batch", raising=False)
    missing = "stable_baselines3" if find_spec("torch") else "torch"  # which is imported first
    with pytest.raises(ModuleNotFoundError, match=rf"SB3Batch needs {missing}.*pip install 'mecp_env\[rl\]'"):
        importlib.import_module("mecp_env.learning.sb3_batch")


def test_the_lowest_versions_are_the_floors_of_all_dependencies() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = {(found := Requirement(line)).name: found.specifier for line in project["dependencies"]}
    tools = {(found := Requirement(line)).name: found.specifier for line in project["optional-dependencies"]["dev"]}
    printed = subprocess.check_output([sys.executable, ROOT / ".ci/lowest.py"], text=True).split()
    lowest = {name: Version(version) for name, _, version in (line.partition("==") for line in printed)}
    assert set(lowest) == {*wanted, "pytest", "pytest-xdist", "hypothesis"}
    for name, version in lowest.items():
        specifier = (tools | wanted)[name]
        assert specifier.contains(version)
        assert {Version(one.version) for one in specifier if one.operator == ">="} == {version}


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
