"""The benchmark `mutated`: what counts as a fault, and a few inputs of each kind."""

import math
import time

import pytest

from benchmarks import mutated, mutated_keywords
from mecp_env.core.errors import ConfigError


@pytest.mark.slow
@pytest.mark.parametrize("kind", mutated.KINDS)
def test_inputs_of_every_kind_end_well(kind: str) -> None:
    ends = [mutated.end_of((kind, number)) for number in range(1000, 1008)]
    assert not [end for end in ends if end["end"] == "raw" or end["seconds"] > mutated.MOST_S]


@pytest.mark.parametrize(
    ("error", "end"), [(ConfigError("x"), "typed"), (ValueError("x"), "raw"), (AssertionError(), "raw")]
)
def test_an_untyped_error_is_a_fault(error: Exception, end: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: object) -> None:
        raise error

    monkeypatch.setitem(mutated_keywords.CALLS, "SlamConfig", fail)
    found = mutated.end_of(("SlamConfig", 1))
    assert found["end"] == end
    assert bool(mutated.fault_of(("SlamConfig", 1), found)) == (end == "raw")


def test_what_hangs_or_takes_much_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mutated, "HANGS_S", 1)
    monkeypatch.setitem(mutated_keywords.CALLS, "SlamConfig", lambda _: time.sleep(30.0))
    assert "more than 1 s" in mutated.fault_of(("SlamConfig", 1), mutated.end_of(("SlamConfig", 1)))
    end = {"end": "right", "said": "", "seconds": 11.0, "mb": 0.0}
    assert "11 s" in mutated.fault_of(("log csv", 1), end)
    assert mutated.fault_of(("log csv", 1), end | {"seconds": 1.0, "mb": math.nextafter(1000.0, 0.0)}) == ""
