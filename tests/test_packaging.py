"""What an installation contains."""

import importlib
import subprocess
import sys
import tomllib
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).parent.parent


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
