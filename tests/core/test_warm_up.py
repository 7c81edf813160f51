"""Compiling ahead: on first use only, in processes that never outlive it."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from mecp_env.core import jit, warm_up

ROOT = Path(warm_up.__file__).parents[2]


@pytest.fixture
def cold(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The place of a cache that is empty."""
    monkeypatch.setattr(jit, "cache_directory", lambda: tmp_path / "cache")
    monkeypatch.delenv(warm_up.SWITCH, raising=False)
    return tmp_path / "cache"


def test_the_first_use_compiles_and_says_so_in_one_line(
    cold: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    driven = list[tuple[str, ...]]()
    monkeypatch.setattr(warm_up, "compile_ahead", lambda drives, report: driven.append(drives) or ())
    with monkeypatch.context() as patch:
        patch.setenv(warm_up.SWITCH, "0")
        warm_up.prepare()
        assert driven == []  # switched off
    warm_up.prepare()
    assert driven == [warm_up.FIRST]
    (record,) = caplog.records
    assert "compiling" in record.message
    assert warm_up.SWITCH in record.message
    cold.with_name("file").touch()
    monkeypatch.setattr(jit, "cache_directory", lambda: cold.with_name("file"))
    warm_up.prepare()
    assert len(driven) == 1  # where nothing can be kept, nothing is compiled ahead


@pytest.mark.slow
def test_what_was_compiled_ahead_is_warm_even_where_a_drive_fails(cold: Path) -> None:
    """It would fail again."""
    assert warm_up.is_cold()
    counts: list[int] = []
    assert warm_up.compile_ahead(["no such drive"], counts.append) == ("no such drive",)
    assert counts[0] == 0
    assert not warm_up.is_cold()


INTERRUPTED = """
import os, signal, sys
from mecp_env.core import jit, warm_up
signal.signal(signal.SIGINT, signal.default_int_handler)
Popen = warm_up.subprocess.Popen
class Noted(Popen):
    def __init__(self, line, **words):
        super().__init__([sys.executable, "-c", "import time; time.sleep(60)"], **words)
        print(self.pid, flush=True)
warm_up.subprocess.Popen = Noted
warm_up.compile_ahead(["a", "b"], lambda count: os.kill(os.getpid(), signal.SIGINT))
"""


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_an_interrupt_ends_the_processes_and_leaves_it_cold(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], env=environment, capture_output=True, text=True)
    assert done.returncode in (130, -signal.SIGINT)
    pids = [int(word) for word in done.stdout.split()]
    assert len(pids) == 2
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
    assert not list(tmp_path.rglob(warm_up.DONE))
