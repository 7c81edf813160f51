"""A file of at most 5 MB that a user received takes at most 300 MB, the whole process, and ends soon."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from mecp_env.core import files
from tests.core import file_bombs
from tests.processes import needs_linux

ROOT = Path(__file__).parents[2]
MOST_MB, MOST_S = 300, 20.0  # of processor time
READS = list(dict.fromkeys(read for _, read in file_bombs.READERS.values()))  # a process each
TRACED = """
import json, sys, tracemalloc
text = sys.stdin.buffer.read().decode()
tracemalloc.start()
value = json.loads(text)
print(tracemalloc.get_traced_memory()[1])
"""


@needs_linux
@pytest.mark.slow
@pytest.mark.parametrize("read", READS, ids=lambda read: read.split()[1])
def test_no_small_file_takes_much_memory(read: str, tmp_path: Path) -> None:
    paths = []
    for kind in (kind for kind, (_, reads) in file_bombs.READERS.items() if reads == read):
        for name, data in file_bombs.bombs(kind):
            paths.append(tmp_path / f"{kind} {name}".replace("/", "_") / file_bombs.READERS[kind][0])
            paths[-1].parent.mkdir()
            paths[-1].write_bytes(data)
    code = file_bombs.MEASURE.replace("READ", read)
    run = subprocess.run([sys.executable, "-c", code, *paths], capture_output=True, text=True, cwd=ROOT, check=False)
    assert run.returncode == 0, run.stderr[-500:]
    rows = [line.split(";") for line in run.stdout.splitlines()]
    assert len(rows) == len(paths) >= 2
    assert not [row for row in rows if float(row[1]) > MOST_MB or float(row[2]) > MOST_S]
    assert all("Error" not in row[3] or "MecpError" in row[3] for row in rows)


@pytest.mark.parametrize("kind", file_bombs.ITEMS)
def test_the_memory_of_values_is_not_underestimated(kind: str) -> None:
    """Python's own allocator says what the values take."""
    text = file_bombs.items(kind, 400_000)
    run = subprocess.run([sys.executable, "-c", TRACED], input=text.encode(), capture_output=True, check=True)
    assert int(run.stdout) < files.memory_of(text.encode()) < 4 * int(run.stdout)


def test_values_that_take_too_much_are_refused_before_they_are_made(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("[" + "[]," * 2_000_000 + "0]")
    with pytest.raises(ValueError, match="too much for its size"):
        files.read_json(tmp_path / "a.json", 10**7)
    with pytest.raises(ValueError, match="at most 10"):
        files.read_json(tmp_path / "a.json", 10)
    (tmp_path / "b.json").write_text("[" * 100_000)
    with pytest.raises(ValueError, match="nested"):
        files.read_json(tmp_path / "b.json", 10**7)
    (tmp_path / "c.json").write_text(json.dumps({"a": [1.5, "\u00e4", None]}))
    assert files.read_json(tmp_path / "c.json", 100) == {"a": [1.5, "\u00e4", None]}
