"""Reports and figures of a part of what a benchmark measures: what is missing is a dash, and no claim holds by it."""

import json
from typing import Any

import pytest

from benchmarks import claims, clutter, filters
from benchmarks.common import RESULTS


def committed(name: str) -> dict[str, Any]:
    figures: dict[str, Any] = json.loads((RESULTS / f"{name}.json").read_text())["figures"]
    return figures


@pytest.mark.parametrize("figure", [None, {"value": None, "low": None, "high": None, "n": 0}])
def test_a_claim_without_a_figure_is_open(figure: object) -> None:
    claim = claims.Claim("I", "sentence", "experiment", "part/figure", at_least=0.5)
    assert claim.holds({"part": {"figure": figure}}) == claim.holds({}) == "open"
    assert "**open**" in claims.report({})


def test_filters_of_which_one_was_measured() -> None:
    figures = committed("filters")
    page = filters.report({"time_us": {"ekf": {"50": figures["time_us"]["ekf"]["50"]}}, "nees": {"linear": {}}})
    assert "| us, landmarks | predict |" in page
    assert "| ekf, 50 |" in page
    lost = {"lap_2": {"value": None, "low": None, "high": None, "n": 0}}
    assert "| linear, ekf | - |" in filters.report({"time_us": {}, "nees": {"linear": {"ekf": lost}}})


def test_clutter_of_which_one_cell_and_one_associator_was_measured() -> None:
    cells = committed("clutter")["paper"]
    cell = clutter.named(1.0, 10)
    figures = {"paper": {cell: {"jcbb": cells[cell]["jcbb"]}}, "other": {}}
    page = clutter.report(figures)
    assert "## paper (" in page
    assert "## other (0 drives)" in page
    assert len(clutter.figure(figures).axes) == 4 * len(clutter.DRAWN)
