"""Files are written whole; what killed writes left is removed, and nothing else."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from mecp_env.core.files import DAY_S, machine, text_of, write_atomic


def test_a_killed_write_leaves_nothing_after_the_next_start(tmp_path: Path) -> None:
    ended = subprocess.Popen([sys.executable, "-c", "pass"])
    ended.wait()
    left = tmp_path / f".a.json.{machine()}-{ended.pid}.tmp"
    running = tmp_path / f".a.json.{machine()}-{os.getppid()}.tmp"
    elsewhere = tmp_path / ".a.json.00000000-1.tmp"
    old = tmp_path / ".b.json.12.tmp"
    foreign = tmp_path / ".notes.tmp"
    for path in (left, running, elsewhere, old, foreign):
        path.write_bytes(b"half")
    long_ago = old.stat().st_mtime - 2 * DAY_S
    os.utime(old, (long_ago, long_ago))
    write_atomic(tmp_path / "a.json", b"whole")
    left.write_bytes(b"half")
    write_atomic(tmp_path / "a.json", b"whole")
    left.unlink()  # it is there: a folder is looked at once
    assert {path.name for path in tmp_path.iterdir()} == {"a.json", running.name, elsewhere.name, foreign.name}


def test_a_name_as_long_as_the_system_allows_is_written(tmp_path: Path) -> None:
    name = "ü" * 120 + ".json"
    write_atomic(tmp_path / name, b"whole")
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-be"])
def test_text_as_editors_and_shells_save_it(encoding: str) -> None:
    mark = "\ufeff" if encoding == "utf-16-be" else ""
    assert text_of((mark + '{"name": "Küche"}').encode(encoding)) == '{"name": "Küche"}'
