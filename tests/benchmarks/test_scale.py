"""The scale benchmark continues the same exploration from the states that it kept."""

from typing import Any

import pytest

from benchmarks import scale
from benchmarks.common import Options
from benchmarks.tables import report_of


def test_a_small_building_gives_ratios_and_the_drift(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    monkeypatch.setattr(scale, "COUNTS", (10, 20))
    monkeypatch.setattr(scale, "QUICK", (10, 20))
    monkeypatch.setattr(scale, "BUILDING", {"rooms": 6})
    monkeypatch.setattr(scale, "ROUNDS", 2)
    monkeypatch.setattr(scale, "BLOCK", 10)
    monkeypatch.setattr(scale, "STEPS", 60)
    figures = scale.run(Options(quick=True, folder=tmp_path))
    assert set(figures) == {"riekf", "riekf_submaps", "blind"}
    assert 0.0 < figures["blind"]["drift"]["median_m"]["value"] < 0.1
    assert figures["blind"]["drift"]["lost"]["value"] == 0.0
    assert figures["riekf"]["10"]["ratio"]["value"] == 1.0
    assert figures["riekf_submaps"]["20"]["ratio"]["value"] > 0.0
    assert "## riekf_submaps" in report_of(figures)
