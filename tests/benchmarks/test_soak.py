"""The soak benchmark watches what it names, and fails where a bound is exceeded."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import common, process_use, soak


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
def test_a_short_run_of_each_kind(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(soak, "COUNT", 2)
    monkeypatch.setattr(soak, "SLICES", 10)
    monkeypatch.setattr(soak, "SAMPLES", 2)
    monkeypatch.setattr(soak, "SETTING", soak.SETTING | {"max_steps": 15})
    options = common.Options(sets=("vector:80", "single:20"), folder=tmp_path)
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
