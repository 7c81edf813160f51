"""A terminal with another encoding than UTF-8: every command prints, and characters that it lacks become `?`."""

import io
import re
import sys
from pathlib import Path

import pytest

from mecp_env.cli import main as cli
from tests.command_lines import ROOT

pytestmark = pytest.mark.usefixtures("blank_figures")

LINES = (
    "worlds stats paper",
    "worlds validate nö.json",
    "demo --layout two_rooms --config.max-steps 5 --out out",
    "evaluate nearest --layout two_rooms --episodes 1 --max-steps 5 --no-truth --out évalué",
    "train ppö",
)


class Terminal(io.TextIOWrapper):
    """A stream of the encoding ASCII that keeps what is printed."""

    def __init__(self) -> None:
        super().__init__(io.BytesIO(), encoding="ascii", errors="strict")

    @property
    def shown(self) -> str:
        self.flush()
        kept: bytes = self.buffer.getvalue()  # type: ignore[attr-defined]
        return kept.decode("ascii")


def test_every_text_file_is_read_and_written_as_utf_8() -> None:
    lines = [line for path in (ROOT / "mecp_env").rglob("*.py") for line in path.read_text().splitlines()]
    calls = [line for line in lines if re.search(r"\.(?:read_text|write_text)\(", line)]
    assert calls
    assert not [line for line in calls if "utf-8" not in line]


@pytest.mark.parametrize("line", LINES)
def test_every_command_prints_and_a_character_that_is_missing_becomes_a_question_mark(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    out, err = Terminal(), Terminal()
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", err)
    code = cli.main(line.split())
    assert code == (2 if line.split()[-1] in ("nö.json", "ppö") else 0)
    assert len(out.shown + err.shown) > 20
    assert ("m?" in out.shown) == ("stats" in line)  # square metres
