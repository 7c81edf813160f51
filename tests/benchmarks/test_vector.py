"""The vector benchmarks measure what their names state."""

import pytest

from benchmarks import vector, vector_step
from benchmarks.tables import report_of


def test_every_kind_has_ratios_within_a_round_and_its_cost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vector, "COUNT", 2)
    monkeypatch.setattr(vector, "memory_alone", lambda *_: 100.0)
    kinds = vector.compare({"laser": {"beams": 90}}, 2, 0.05)
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
    kinds = vector_step.compare({"laser": {"beams": 90}}, 2, 0.05, (1, 3))
    assert kinds[vector_step.SINGLE]["over_single"]["value"] == 1.0
    assert kinds["batch of 3"]["steps_per_s"]["n"] == 2
    assert kinds["batch of 3"]["steps_per_s"]["value"] > kinds["batch of 3"]["over_single"]["value"] > 0.0
    assert "| batch of 3 |" in report_of({"velocity": kinds})
