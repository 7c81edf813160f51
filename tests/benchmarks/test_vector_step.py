"""The benchmark of Gymnasium's own figures: every count has a rate, and its ratio to a single environment."""

from benchmarks import vector_step


def test_every_count_has_gymnasiums_figure_and_its_ratio() -> None:
    kinds = vector_step.compare({"laser": {"beams": 90}}, 2, 0.05, (1, 3))
    assert kinds[vector_step.SINGLE]["over_single"]["value"] == 1.0
    assert kinds["batch of 3"]["steps_per_s"]["n"] == 2
    assert kinds["batch of 3"]["steps_per_s"]["value"] > kinds["batch of 3"]["over_single"]["value"] > 0.0
    assert "| batch of 3 |" in vector_step.report({"velocity": kinds})
