"""`mecp-env completion`: scripts for shells that complete commands and options."""

import shutil
import subprocess
from pathlib import Path

import pytest

from mecp_env.cli import main as cli

Captured = pytest.CaptureFixture[str]
ASK = """
source "$1"; shift
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMP_LINE="$*"; COMP_POINT=${#COMP_LINE}
$(complete -p mecp-env | sed 's/.*-F \\([^ ]*\\).*/\\1/')
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.mark.skipif(shutil.which("bash") is None, reason="runs bash")
def test_bash_completes_commands_and_options(tmp_path: Path, capsys: Captured) -> None:
    file = tmp_path / "completion"
    assert cli.main(["completion", "bash"]) == 0
    file.write_text(capsys.readouterr().out)

    def completed(*words: str) -> list[str]:
        line = ["bash", "-c", ASK, "bash", str(file), "mecp-env", *words]
        return subprocess.run(line, capture_output=True, text=True, check=True).stdout.split()

    assert completed("ex") == ["explore", "export"]
    assert "stats" in completed("worlds", "st")
    assert "--save-map" in completed("demo", "--save")
