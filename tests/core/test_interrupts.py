"""Ctrl-C is never lost, and ends the process of the command with one line and exit code 130."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from mecp_env.core.interrupts import interrupts_later

ROOT = Path(__file__).parents[2]
AS_COMMAND = "import sys; sys.argv = ['mecp-env']; sys.orig_argv = ['python', 'mecp-env']; import mecp_env, signal\n"
ONE_LINE = "mecp-env: interrupted\n"


@pytest.fixture(autouse=True)
def _heard() -> Any:
    """Tests that run in the background of a shell are deaf to Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def run(*line: str, path: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """A Python process that hears Ctrl-C."""

    def hear() -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)

    environment = os.environ | {"PYTHONPATH": f"{path}{os.pathsep}{ROOT}"}
    pipes: dict[str, Any] = {"capture_output": True, "text": True, "timeout": 60}
    return subprocess.run([sys.executable, *line], env=environment, preexec_fn=hear, check=False, **pipes)


def test_an_interrupt_comes_after_the_work() -> None:
    done = list[str]()

    def work() -> None:
        with interrupts_later(), interrupts_later():
            assert signal.getsignal(signal.SIGINT) is not signal.default_int_handler
            signal.raise_signal(signal.SIGINT)
            done.append("work")

    with pytest.raises(KeyboardInterrupt):
        work()
    assert done == ["work"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_interrupt_while_modules_are_imported_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "tyro.py").write_text("import signal\nsignal.raise_signal(signal.SIGINT)\n")
    ended = run("-m", "mecp_env", "explore", "nearest", path=tmp_path)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", ONE_LINE)


@pytest.mark.parametrize(
    "script",
    [
        "class A:\n  def __del__(self): signal.raise_signal(signal.SIGINT)\nA()\nimport time; time.sleep(60)",
        "try: signal.raise_signal(signal.SIGINT)\nexcept BaseException: raise ValueError",
    ],
)
def test_an_interrupt_that_python_would_lose_ends_the_command(script: str) -> None:
    ended = run("-c", AS_COMMAND + script)
    assert (ended.returncode, ended.stderr) == (130, ONE_LINE)


CAUGHT = """
from mecp_env.cli.base import at_end, run_command
def work():
    try: signal.raise_signal(signal.SIGINT)
    except BaseException: return 0
sys.exit(at_end(run_command(work)))
"""
LATE = """
from mecp_env.cli.base import at_end
import atexit
atexit.register(signal.raise_signal, signal.SIGINT)
sys.exit(at_end(0))
"""


@pytest.mark.parametrize(
    ("script", "code", "last"),
    [(CAUGHT, 130, []), (LATE, 130, []), ("raise ValueError('other')", 1, ["ValueError: other"])],
)
def test_the_end_of_the_command_is_told_by_its_exit_code(script: str, code: int, last: list[str]) -> None:
    ended = run("-c", AS_COMMAND + script)
    assert (ended.returncode, ended.stderr.splitlines()[-1:]) == (code, last)
