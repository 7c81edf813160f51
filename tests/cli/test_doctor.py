"""`mecp-env doctor`: passed checks, messages about a faulty machine, exit codes."""

from collections.abc import Iterator
from pathlib import Path

import numba
import numpy as np
import pytest
from packaging.requirements import Requirement

from mecp_env.cli import doctor
from mecp_env.cli import main as cli
from mecp_env.cli.doctor import Finding
from mecp_env.core import jit, warm_up

Said = pytest.CaptureFixture[str]


def test_a_sound_machine_passes(monkeypatch: pytest.MonkeyPatch, capsys: Said) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    assert cli.main(["doctor", "--seconds", "0.1"]) == 0
    said = capsys.readouterr().out
    for name in ("Python", "numba", "pygame-ce", "function cache", "display"):
        assert f"PASS  {name} " in said
    assert "  self-test: drive " in said  # slow where the machine is busy
    assert said.splitlines()[-1].endswith("0 FAIL")


def test_a_failure_gives_exit_code_1_and_the_rest_is_still_checked(
    monkeypatch: pytest.MonkeyPatch, capsys: Said
) -> None:
    def broken(seconds: float) -> Iterator[Finding]:
        yield Finding("PASS", "first", "fine")
        raise RuntimeError("out of order")

    def last(seconds: float) -> Iterator[Finding]:
        yield Finding("WARN", "last", "so so", "try harder")

    monkeypatch.setattr(doctor, "CHECKS", (broken, last))
    assert cli.main(["doctor"]) == 1
    said = capsys.readouterr().out
    assert "FAIL  broken            RuntimeError: out of order" in said
    assert "-> try harder" in said
    assert said.splitlines()[-1] == "1 PASS, 1 WARN, 1 FAIL"


@pytest.mark.parametrize(
    ("needed", "verdict", "fix"),
    [
        ("numpy>=1.26", "PASS", ""),
        ("numpy>=99", "FAIL", 'pip install "numpy>=99"'),
        ("no-such-thing>=1", "FAIL", 'pip install "no-such-thing>=1"'),
    ],
)
def test_a_dependency_is_there_too_old_or_missing(needed: str, verdict: str, fix: str) -> None:
    found = doctor.dependency(Requirement(needed))
    assert (found.verdict, found.fix) == (verdict, fix)


def test_the_cache_of_compiled_functions_is_judged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = tmp_path / "cache"  # which can be made
    monkeypatch.setattr(jit, "cache_directory", lambda: place)
    writable, cold = doctor.compiled_functions(0.0)
    assert (writable.verdict, cold.verdict) == ("PASS", "WARN")
    assert "compiles first" in cold.said
    assert cold.fix == "mecp-env warmup"
    (place / warm_up.DONE).touch()
    (warm,) = doctor.compiled_functions(0.0)
    assert warm.verdict == "PASS"
    place.with_name("file").touch()
    monkeypatch.setattr(jit, "cache_directory", lambda: place.with_name("file"))
    (unwritable,) = doctor.compiled_functions(0.0)
    assert unwritable.verdict == "WARN"
    assert "NUMBA_CACHE_DIR" in unwritable.fix
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)
    first, *_ = doctor.compiled_functions(0.0)
    assert "NUMBA_DISABLE_JIT" in first.said


def test_a_missing_display_is_no_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "none_such")
    (found,) = doctor.display(0.0)
    assert found.verdict == "WARN"
    assert "DISPLAY" in found.fix


def test_a_drive_is_judged_by_its_speed_its_error_and_its_observations() -> None:
    verdicts = [doctor.judge(100, *given).verdict for given in ((500.0, 0.01), (10.0, 0.01), (500.0, 3.0))]
    assert verdicts == ["PASS", "WARN", "FAIL"]
    same = {"pose": np.zeros(4), "grid": np.ones(3)}
    assert doctor.same_again(same, {**same}).verdict == "PASS"
    found = doctor.same_again(same, same | {"grid": np.zeros(3)})
    assert found.verdict == "FAIL"
    assert "grid" in found.said
