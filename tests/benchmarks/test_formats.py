"""The benchmark of the formats: figures of each format, rows, tables."""

from __future__ import annotations

import pytest

from benchmarks import formats


@pytest.mark.slow
def test_a_comparison_has_the_time_of_each_format_and_a_row() -> None:
    figures = {"time": {"PaperMap, goal": formats.compare("PaperMap", "goal", 2)}, "rows": {}}
    times = figures["time"]["PaperMap, goal"]
    assert tuple(times) == ("dict_ms", "flat", "image", "none")
    assert all(time["value"] > 0.0 for time in times.values())
    assert "| PaperMap, goal |" in formats.report(figures)


def test_every_offered_row_is_described() -> None:
    rows = formats.rows_described("PaperMap", 1)
    assert rows["described"]["value"] == 1.0
    assert rows["decisions"] > 1
    assert rows["described"]["n"] == round(rows["offered"] * rows["decisions"])
