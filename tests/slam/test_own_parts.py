"""Custom associators and filters, registered by name for every configuration (docs/own-parts.md)."""

import importlib
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import mecp_env  # noqa: F401  (registers the environments)
from benchmarks import __main__ as command
from benchmarks import association as benchmark
from mecp_env.core.errors import ConfigError
from mecp_env.evaluation.part_checks import check_associator, check_filter
from mecp_env.slam import config
from mecp_env.slam.association import register_associator
from mecp_env.slam.config import SlamConfig
from mecp_env.slam.filters import Ekf, RightInvariantEkf, register_filter
from mecp_env.slam.pipeline import SlamPipeline
from tests.command_lines import written_modules
from tests.env.helpers import episode_of
from tests.slam.drives import Drive

OWN = {"association": {"method": "global_nearest"}, "filter": {"kind": "plain_ekf"}, "polygon": {"structure": "both"}}


@pytest.fixture
def own(own_parts: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, ModuleType]:
    """The modules of the page, imported; their registrations are removed afterwards."""
    monkeypatch.syspath_prepend(own_parts)
    written_modules(own_parts)
    return {name: importlib.import_module(name) for name in ("global_nearest", "plain_ekf", "both")}


def test_the_parts_of_the_page_run_in_an_environment_and_its_states(own: dict[str, ModuleType]) -> None:
    env = gym.make("mecp_env/PaperMap-v0", slam=OWN).unwrapped
    env.reset(seed=1)
    for _ in range(20):
        env.step(np.array([0.5, 0.1]))
    pipeline, second = episode_of(env).pipeline, SlamPipeline(OWN)
    assert type(second.associator) is type(pipeline.associator)
    assert second.associator is not pipeline.associator
    assert type(pipeline.associator) is own["global_nearest"].GlobalNearest
    assert type(pipeline.filter) is own["plain_ekf"].PlainEkf
    assert len(env.slam_output.belief.ids) > 5
    state = env.get_state()
    other = gym.make("mecp_env/PaperMap-v0", slam=OWN).unwrapped
    other.set_state(state)
    first, second = (e.step(np.array([0.3, -0.2]))[0] for e in (env, other))
    assert all(np.array_equal(first[key], second[key]) for key in first)


def test_they_pass_the_checks_of_the_page(own: dict[str, ModuleType]) -> None:
    assert check_associator(own["global_nearest"].GlobalNearest) > 0
    check_filter(own["plain_ekf"].PlainEkf)


class Boxed:
    """A filter that keeps another one inside, as a custom filter may."""

    def __init__(self, config: config.FilterConfig) -> None:
        self.inner = RightInvariantEkf(config)

    def __getattr__(self, name: str) -> Any:
        if name in ("inner", "slot_ids"):  # absent while a copy is made; unknown to states
            raise AttributeError(name)
        return getattr(self.inner, name)

    @property
    def ids(self) -> Any:
        return self.inner.ids


def test_a_map_holds_them(own: dict[str, ModuleType], drive: Drive, tmp_path: Path) -> None:
    register_filter("boxed", Boxed)
    pipeline = SlamPipeline({**OWN, "filter": {"kind": "boxed"}})
    pipeline.start(drive.scans[0])
    for k in range(3, 20):
        pipeline.step(drive.odometry[k], drive.scans[k])
    pipeline.save_map(tmp_path / "map.zip")
    other = SlamPipeline.from_map(tmp_path / "map.zip")
    assert type(other.associator) is own["global_nearest"].GlobalNearest
    assert type(other.filter) is Boxed
    first, second = (one.step(drive.odometry[20], drive.scans[20]).belief for one in (pipeline, other))
    assert np.array_equal(first.p_map, second.p_map)


def test_the_benchmark_has_a_row_for_each(own: dict[str, ModuleType], capsys: pytest.CaptureFixture[str]) -> None:
    rows = benchmark.methods()
    assert list(rows)[-2:] == ["global_nearest", "mecp, filter plain_ekf"]
    assert command.main(["association", "--with", "global_nearest", "plain_ekf", "--sets", "two_rooms:1"]) == 0
    said = capsys.readouterr().out
    assert "## two_rooms (1 seeds)" in said
    assert "| global_nearest |" in said
    assert "| mecp, filter plain_ekf |" in said
    assert "## paper" not in said


@pytest.mark.parametrize(
    ("register", "name", "said"),
    [
        (register_associator, "mecp", r"name: 'mecp' is one of ours \(mecp, mecp_paper, jcbb, ccda, .*known\)"),
        (register_associator, "two words", r"name: 'two words', letters, digits and _ expected"),
        (register_filter, "ekf", r"name: 'ekf' is one of ours \(riekf, riekf_submaps, ekf, fej\)"),
    ],
)
def test_names_that_cannot_be_registered(register, name, said) -> None:
    with pytest.raises(ConfigError, match=said):
        register(name, Ekf)


def test_a_name_that_nobody_registered_is_told_with_those_there_are() -> None:
    with pytest.raises(ConfigError, match=r"association\.method: .*'nearest_descriptor' or 'known'.*mean 'nearest'"):
        SlamConfig(association={"method": "nearst"})
    with pytest.raises(ConfigError, match=r"filter\.kind: .*'riekf', 'riekf_submaps', 'ekf' or 'fej'.*mean 'ekf'"):
        SlamConfig(filter={"kind": "ekff"})
