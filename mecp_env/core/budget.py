"""The metres over which a coverage curve is normalised."""

from __future__ import annotations

BUDGET_M_PER_M2 = 0.5  # metres of an exploration per m2 of floor


def budget_m(free_area_m2: float) -> float:
    """The metres by which a curve is normalised: a function of the building alone, the same for every policy."""
    return BUDGET_M_PER_M2 * free_area_m2
