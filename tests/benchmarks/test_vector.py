"""The parts of the vector benchmark measure what their names state."""

import pytest

from benchmarks import vector
from benchmarks.tables import flatten


@pytest.mark.parametrize("setting", vector.SETTINGS)
def test_every_kind_is_driven_the_same_way(setting: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vector, "COUNT", 2)
    drivers = [vector.Driver(kind, vector.SETTINGS[setting]) for kind in ("sync", "batch")]
    for _ in range(3):
        assert drivers[0].step() == drivers[1].step() >= 2
        assert all((drivers[0].observation[key] == drivers[1].observation[key]).all() for key in vector.SMALL)
    assert ("grid" in drivers[0].observation) == (setting != "small")
    assert len(drivers[0].pids()) == 1
    assert len(drivers[1].pids()) >= 2
    for driver in drivers:
        driver.close()


def test_what_is_ready_is_driven_on_while_the_others_are_under_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vector, "COUNT", 4)
    driver = vector.Driver(vector.SEND_RECV, vector.SETTINGS["velocity"])
    assert sum(driver.step() for _ in range(6)) in range(10, 13)  # twelve rows, of which at most two are resets
    assert len(driver.observation["pose"]) == 2
    assert len(driver.pids()) >= 2
    driver.close()


def test_the_figures_have_ratios_within_a_round_and_the_gates_name_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vector, "COUNT", 2)
    monkeypatch.setattr(vector, "memory_alone", lambda *_: 100.0)
    own = vector.SINGLE, vector.ASYNC, vector.BATCH, vector.SEND_RECV
    kinds = vector.compare(vector.SETTINGS["velocity"], 2, 0.05, own)
    assert kinds["single"]["over_single"]["value"] == 1.0
    assert kinds["batch"]["over_async"]["n"] == 2
    assert kinds["batch"]["processor_us"]["value"] > 0.0
    assert {gate.path for gate in vector.GATES} <= flatten({"velocity": kinds}).keys()
    assert "| batch |" in vector.report({"velocity": kinds})


@pytest.mark.slow
def test_memory_is_that_of_a_process_that_drives_one_kind_only() -> None:
    grown = b"x" * 300_000_000
    assert 150.0 < vector.memory_alone(vector.BATCH, vector.SETTINGS["velocity"], 2) < 300.0
    assert len(grown) == 300_000_000
