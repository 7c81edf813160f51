"""Policies by name."""

import sys
import types
from pathlib import Path
from typing import Any

import pytest

from mecp_env.core.errors import ConfigError
from mecp_env.policies import registry
from mecp_env.policies.explorers import Nearest
from mecp_env.policies.registry import make_policy
from mecp_env.policies.rollout import EpisodeTask, Setting, options_of, run_episode
from tests.command_lines import modules_of_page
from tests.processes import run_python


def test_a_trained_policy_without_pytorch_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    def load(name: str, trust: bool) -> Nearest:
        raise ModuleNotFoundError("No module named 'torch'", name="torch")

    monkeypatch.setitem(sys.modules, "mecp_env.learning.learned", types.SimpleNamespace(load=load))
    with pytest.raises(ConfigError, match=r"'ppo' is a trained policy and needs torch; install the extra `rl`"):
        make_policy("ppo")


def test_explorers_load_nothing_of_learning() -> None:
    code = (
        "import sys; from mecp_env.policies.registry import *; [make_policy(n) for n in EXPLORERS]; print(*sys.modules)"
    )
    loaded = set(run_python(code).split())
    assert not {"torch", "stable_baselines3", "sb3_contrib", "mecp_env.learning.learned"} & loaded


def test_the_policy_of_the_documentation_explores(monkeypatch: pytest.MonkeyPatch) -> None:
    made = types.ModuleType("farthest")
    exec(modules_of_page()["farthest"], made.__dict__)
    monkeypatch.setitem(sys.modules, "farthest", made)
    episode = run_episode(EpisodeTask("farthest:Farthest", 0, Setting("easy", "validation", "slam", 60)))
    assert episode.figures["coverage"] > 0.3
    text = (Path(__file__).parents[2] / "docs/policies.md").read_text()
    assert all(f"| `{name}` |" in text for name in registry.EXPLORERS)


class NoFile(Nearest):
    """A policy that cannot be made."""

    def __init__(self) -> None:
        raise ValueError("no model file")


class Leaves(Nearest):
    """A policy that ends the process."""

    def __init__(self) -> None:
        raise SystemExit(0)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (f"{__name__}:NoFile", r"NoFile' cannot be constructed: ValueError: no model file \(__init__, line"),
        (f"{__name__}:Leaves", r"Leaves' ends the process \(SystemExit: 0\)"),
        (f"{__file__}", r"test_registry\.py:MyPolicy"),
        ("", "expected one of"),
        ("nearst", r"expected one of bfs, nearest, .*maskable_ppo.*did you mean 'nearest'\?"),
        ("qqqqqq", r"expected one of (?!.*did you mean)"),
    ],
)
def test_a_name_of_no_policy_that_can_be_made_says_why(name: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        make_policy(name)


def test_a_file_below_the_working_directory_names_its_class(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "deep").mkdir()
    for file in ("own_file.py", "2nd own-file.py"):
        (tmp_path / "deep" / file).write_text("from mecp_env.policies.explorers import Nearest as Own\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [*sys.path])
    for name in ("deep/own_file.py:Own", "./deep/own_file.py:Own", f"{tmp_path}/deep/2nd own-file.py:Own"):
        assert type(make_policy(name)) is Nearest
        assert registry.policy_checksum(name)
    with pytest.raises(ConfigError, match=r"did you mean 'deep/own_file\.py'"):
        make_policy("deep/own_file")


def test_statistics_are_found_by_their_usual_names_and_not_left_out_in_silence(tmp_path: Path) -> None:
    usual = {"my_vecnormalize.pkl": "my.zip", "vec_normalize.pkl": "my.zip"}
    usual["rl_model_vecnormalize_1000_steps.pkl"] = "rl_model_1000_steps.zip"  # as `CheckpointCallback` names them
    for name, model in usual.items():
        folder = tmp_path / name.removesuffix(".pkl")
        folder.mkdir()
        for file in (name, model, "other.zip", "other_vecnormalize.pkl"):
            (folder / file).write_bytes(b"VecNormalize")
        assert registry.statistics_of(folder / model) == folder / name
    for name in ("replay_buffer.pkl", "my.zip"):
        (tmp_path / name).write_bytes(b"content")
    assert registry.statistics_of(tmp_path / "my.zip") is None
    (tmp_path / "statistics.pkl").write_bytes(b"stable_baselines3 VecNormalize")
    with pytest.raises(ConfigError, match=r"statistics\.pkl; name those of this model my_vecnormalize\.pkl"):
        registry.statistics_of(tmp_path / "my.zip")


class Wrong(Nearest):
    """A policy whose settings are no fields."""

    def __init__(self, settings: Any) -> None:
        self.settings = settings


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (5, "5, expected a dict"),
        ({"observatoin": "flat"}, "observatoin: no such field; did you mean 'observation'"),
        ({"max_steps": 5, "estimator": "truth"}, "of estimator, max_steps, which the evaluation selects"),
        ({"reward": {"preset": "coverage", "area": 3.0}}, "area: 3 contradicts the preset 'coverage'"),
        ({"actions": "velocity"}, "of actions 'velocity', but its `actions` are 'goal'"),
    ],
)
def test_settings_that_are_no_fields_are_refused(settings: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=f"policy: 'Wrong': settings.*{message}"):
        options_of(Wrong(settings))


def test_a_registered_name_stands_for_a_class_in_every_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "EXPLORERS", dict(registry.EXPLORERS))
    registry.register_policy("closest", "mecp_env.policies.explorers:Nearest")
    assert type(make_policy("closest")).__name__ == "Nearest"
    assert registry.source_of("closest") == "mecp_env.policies.explorers:Nearest"
    assert registry.source_of("nearest") == "nearest"
    assert registry.policy_checksum("closest")
    registry.register_policy("closest", "mecp_env.policies.explorers:Gain")  # replaces the first
    assert type(make_policy("closest")).__name__ == "Gain"
    wrong: list[Any] = [("nearest", "a:B"), ("two words", "a:B"), (3, "a:B"), ("ppo", "a:B"), ("new", "no class")]
    for name, path in [*wrong, ("new", Nearest), ("new", lambda: Nearest())]:
        with pytest.raises(ConfigError):
            registry.register_policy(name, path)


class Reads(Nearest):
    """A policy that names the files that it reads."""

    files: Any = ()


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ("weights.pt", r"files: weights\.pt: no such file"),
        (("there", "weights.pt"), r"files: weights\.pt: no such file"),
        ((".",), r"files: \.: no such file"),
        (3, r"files 3, expected a tuple of paths"),
    ],
)
def test_a_file_that_a_class_names_and_that_is_none_is_refused(
    files: Any, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its contents would not count, and the scores of other weights would be kept."""
    monkeypatch.chdir(tmp_path)
    Path("there").write_text("one")
    monkeypatch.setattr(Reads, "files", files)
    with pytest.raises(ConfigError, match=message):
        registry.policy_checksum(f"{__name__}:Reads")
    monkeypatch.setattr(Reads, "files", Path("there"))
    with pytest.raises(ConfigError, match="expected a tuple of paths"):
        registry.policy_checksum(f"{__name__}:Reads")
    monkeypatch.setattr(Reads, "files", ("there",))
    before = registry.policy_checksum(f"{__name__}:Reads")
    Path("there").write_text("two")
    assert registry.policy_checksum(f"{__name__}:Reads") != before
