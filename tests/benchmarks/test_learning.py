"""The parts of the benchmark of training measure what their names state."""

import pytest

from benchmarks.tables import flatten, report_of
from tests.learning.training import QUICK

pytest.importorskip("sb3_contrib")
learning = pytest.importorskip("benchmarks.learning")


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", learning.ALGORITHMS)
def test_a_round_compares_a_training_with_its_own_environment(algorithm: str) -> None:
    fields = {name: value for name, value in QUICK.items() if name not in ("log", "steps")}
    figures = learning.compare(algorithm, 2, 0.05, 2, **fields)
    assert figures["over_single"]["n"] == 2
    assert figures["steps_per_s"]["value"] > 0.0
    assert 0.0 < figures["waiting"]["value"] < 1.0
    assert f"{algorithm}/over_single" in flatten({algorithm: figures})
    assert f"| {algorithm} |" in report_of({algorithm: figures})
