"""The coverage of a building, and its correct coverage, as functions of metres and control steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mecp_env.core.carriers import Array


@dataclass(slots=True, eq=False)
class CoverageCurve:
    """The largest coverage so far, at each distance where it grew; a step function.

    With `falls`, the coverage itself at each distance where it changed: a map that slides off is correct no longer.
    """

    falls: bool = False
    metres: list[float] = field(default_factory=list)
    steps: list[int] = field(default_factory=list)
    coverage: list[float] = field(default_factory=list)

    def add(self, metres: float, step: int, coverage: float) -> None:
        """Add the coverage after a step; only an increase is kept, or with `falls` a change."""
        last = self.coverage[-1] if self.coverage else -1.0
        if coverage > last or (self.falls and coverage != last):
            self.metres.append(metres)
            self.steps.append(step)
            self.coverage.append(coverage)

    def area_under(self, limit_m: float) -> float:
        """Mean coverage over the first `limit_m` metres: (1/L) * integral of C(d) from 0 to L.

        C(d) is the largest coverage that was reached within d metres. After the end of the episode it is constant;
        metres beyond L do not count.
        """
        return self._mean(self.metres, limit_m)

    def area_under_steps(self, limit: int) -> float:
        """The same over the first `limit` control steps."""
        return self._mean(self.steps, float(limit))

    def _mean(self, at: Sequence[float], limit: float) -> float:
        bounds = np.minimum(np.array([*at, np.inf]), limit)
        return float(np.sum(np.array(self.coverage) * np.diff(bounds)) / limit)

    def at(self, metres: Array) -> Array:
        """C(d) at some distances (n,), which are not before the first point."""
        rows = np.searchsorted(np.array(self.metres), metres, side="right") - 1
        values: Array = np.array(self.coverage)[rows]
        return values

    def first(self, level: float) -> int | None:
        """Index of the first point with that coverage; None when it was never reached."""
        return next((row for row, coverage in enumerate(self.coverage) if coverage >= level), None)

    def metres_to(self, level: float, otherwise: float) -> float:
        """Metres to a coverage, at most `otherwise`, also where it was never reached (for a restricted mean)."""
        row = self.first(level)
        return otherwise if row is None else min(self.metres[row], otherwise)

    def steps_to(self, level: float, otherwise: float) -> float:
        """Control steps to a coverage, at most `otherwise`, also where it was never reached."""
        row = self.first(level)
        return otherwise if row is None else min(float(self.steps[row]), otherwise)
