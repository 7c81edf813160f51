"""Benchmarks of time and memory measure what their names state."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from benchmarks import common, formats, peers, process_use, replay, scale, soak, vector, vector_step
from benchmarks.browser import chromium
from benchmarks.common import Options
from benchmarks.tables import report_of
from mecp_env.wrappers import RecordReplay

FEW_BEAMS = {"laser": {"beams": 90}}


def patch(monkeypatch: pytest.MonkeyPatch, module: Any, **values: Any) -> None:
    for name, value in values.items():
        monkeypatch.setattr(module, name, value)


def test_every_offered_row_is_described() -> None:
    rows = formats.rows_described("PaperMap", 1)
    assert rows["described"]["value"] == 1.0
    assert rows["decisions"] > 1
    assert rows["described"]["n"] == round(rows["offered"] * rows["decisions"])


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["maskable_ppo", "ppo"])
def test_a_round_compares_a_training_with_its_own_environment(algorithm: str) -> None:
    pytest.importorskip("sb3_contrib")
    from benchmarks import learning
    from tests.learning.training import QUICK

    fields = {name: value for name, value in QUICK.items() if name not in ("log", "steps")}
    figures = learning.compare(algorithm, 2, 0.05, 2, **fields)
    assert figures["over_single"]["n"] == 2
    assert figures["steps_per_s"]["value"] > 0.0
    assert 0.0 < figures["waiting"]["value"] < 1.0


def test_every_kind_has_ratios_within_a_round_and_its_cost(monkeypatch: pytest.MonkeyPatch) -> None:
    patch(monkeypatch, vector, COUNT=2, memory_alone=lambda *_: 100.0)
    kinds = vector.compare(FEW_BEAMS, 2, 0.05)
    assert list(kinds) == list(vector.KINDS)
    assert kinds["single"]["over_single"]["value"] == 1.0
    assert kinds["batch"]["over_async"]["n"] == 2
    assert min(kind["processor_us"]["value"] for kind in kinds.values()) > 0.0
    assert "| batch, send, recv |" in report_of({"velocity": kinds})


@pytest.mark.slow
def test_memory_is_that_of_a_process_that_drives_one_kind_only() -> None:
    grown = b"x" * 300_000_000
    assert 150.0 < vector.memory_alone("batch", {}, 0.1) < 300.0
    assert len(grown) == 300_000_000


def test_every_count_has_gymnasiums_figure_and_its_ratio() -> None:
    kinds = vector_step.compare(FEW_BEAMS, 2, 0.05, (1, 3))
    assert kinds[vector_step.SINGLE]["over_single"]["value"] == 1.0
    assert kinds["batch of 3"]["steps_per_s"]["n"] == 2
    assert kinds["batch of 3"]["steps_per_s"]["value"] > kinds["batch of 3"]["over_single"]["value"] > 0.0


def test_a_small_building_gives_ratios_and_the_drift(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The same exploration goes on from the states that were kept."""
    patch(monkeypatch, scale, COUNTS=(10, 20), QUICK=(10, 20), BUILDING={"rooms": 6}, ROUNDS=2, BLOCK=10, STEPS=60)
    figures = scale.run(Options(quick=True, folder=tmp_path))
    assert set(figures) == {"riekf", "riekf_submaps", "blind"}
    assert 0.0 < figures["blind"]["drift"]["median_m"]["value"] < 0.1
    assert figures["blind"]["drift"]["lost"]["value"] == 0.0
    assert figures["riekf"]["10"]["ratio"]["value"] == 1.0
    assert figures["riekf_submaps"]["20"]["ratio"]["value"] > 0.0


def watched(**changes: Any) -> soak.Soak:
    n = soak.SLICES
    parts: dict[str, Any] = {"steps": [10] * n, "seconds": [0.1] * n, "processor_s": [0.1] * n}
    parts |= {"memory_mb": [300.0] * n, "files": [9] * n, "segments": [2] * n, "episodes": [1] * n}
    parts |= {name: changes.pop(name) for name in parts if name in changes}
    slices = [dict(zip(parts, row, strict=True)) for row in zip(*parts.values(), strict=True)]
    return soak.Soak(slices, **changes)


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({}, ""),
        ({"memory_mb": [300.0] * 90 + [305.5] * 10}, "growth_mb 5.5, at most 5"),
        ({"files": [9] * 99 + [10]}, "more_files 1, at most 0"),
        ({"segments": [2] * 99 + [3]}, "more_segments 1, at most 0"),
        ({"wrong": 1}, "wrong_observations 1, at most 0"),
        ({"left_behind": 2}, "left_behind 2, at most 0"),
        ({"processor_s": [0.1] * 90 + [0.12] * 10}, "processor_time_last_over_first 1.2, at most 1.1"),
        ({"episodes": [0] * 100}, "no episode ended"),
    ],
)
def test_what_exceeds_a_bound_is_named(changes: dict[str, Any], fault: str) -> None:
    figures = {"vector": soak.summarise(watched(**changes))}
    assert soak.faults(figures) == ([f"vector: {fault}"] if fault else [])


@pytest.mark.slow
def test_a_short_soak_of_each_kind(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    patch(monkeypatch, soak, COUNT=2, SLICES=10, SAMPLES=2, SETTING=soak.SETTING | {"max_steps": 15})
    options = Options(sets=("vector:80", "single:20"), folder=tmp_path)
    figures = soak.run(options)
    for values in figures.values():
        assert values["steps"] >= 20
        assert values["episodes"] > 0
        assert values["memory_mb"] > 10.0
        assert values["wrong_observations"] == values["left_behind"] == values["more_files"] == 0
    assert soak.run(options) == figures  # both are kept


def test_what_is_opened_is_counted(tmp_path: Path) -> None:
    before = process_use.open_files(["self"]), process_use.shared_segments(["self"])
    with (tmp_path / "f").open("wb+") as file:
        np.memmap(file, mode="w+", shape=4096)
        mapped = np.memmap(file, mode="r+", shape=4096)
        after = process_use.open_files(["self"]), process_use.shared_segments(["self"])
        del mapped
    assert after[0] >= before[0] + 1
    assert after[1] == before[1] + 1


def test_peers_that_are_not_installed_are_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(common.importlib.util, "find_spec", lambda name: None)
    assert peers.measure(1, (1,)) == {}
    assert capsys.readouterr().err.count("is not installed (extra `peers`)") == 2
    assert "not installed" in peers.report({})


def test_our_speed_is_divided_by_that_of_the_peer(monkeypatch: pytest.MonkeyPatch) -> None:
    def timed(seconds: float) -> SimpleNamespace:
        return SimpleNamespace(seconds_per_step=lambda actions: seconds)

    patch(monkeypatch, peers, is_installed=lambda package: package == "irsim", peer=lambda name: timed(0.001))
    patch(monkeypatch, peers, ours=lambda sweeps, actions: timed(0.002 * sweeps))
    figures = peers.measure(3, (1, 4))
    for sweeps, expected in (("K=1", 0.5), ("K=4", 0.125)):
        for values in figures["ir-sim"][sweeps].values():
            assert values["ratio"]["value"] == pytest.approx(expected)
            assert values["peer_steps_per_s"] == pytest.approx(1000.0)
    assert peers.report(figures).count("| ir-sim, K=") == 4
    faces = sum(len(part["shape"]["vertices"]) - 1 for part in peers.world()["obstacle"])
    assert faces == 98  # the walls of the layout


@pytest.mark.parametrize("actions", ["random", "breadth_first"])
def test_our_blocks_go_on_in_a_new_episode(actions: str) -> None:
    assert peers.ours(1, actions).seconds_per_step(3) > 0.0


@pytest.mark.parametrize("name", peers.PACKAGES)
def test_a_block_of_a_peer_is_timed(name: str) -> None:
    pytest.importorskip(peers.PACKAGES[name])
    assert peers.peer(name).seconds_per_step(20) > 0.0


@pytest.mark.skipif(chromium() is None, reason="no Chromium on this machine")
def test_a_page_is_timed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay, "PLAYED_S", 0.3)
    env = RecordReplay(gym.make("mecp_env/Layout-v0", layout="two_rooms", disable_env_checker=True), tmp_path)
    env.reset(seed=0)
    for _ in range(20):
        env.step(np.array([0.5, 0.1], np.float32))
    env.close()
    first, rate = replay.show(tmp_path / "episode-0000.html")
    assert 0.0 < first < 60.0
    assert rate > 0.0
