"""The cost of reading untrusted files, in a separate process that measures their memory."""

import subprocess
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from mecp_env.core.errors import LayoutError
from mecp_env.floorplans import load_plan
from mecp_env.world.layout import load_layout
from tests.effort import cost

SECONDS, MEGABYTES = 2.0, 200  # within which a file is read or refused

Reader = Callable[[str], object]
Row = tuple[float, float, int, str]  # seconds, megabytes, letters of the refusal (0: it was read), name of the file


def layout(name: str) -> object:
    """One of our own layouts."""
    return load_layout(name)


def plan(name: str) -> object:
    """A plan in any other format."""
    return load_plan(name, resolution_m=0.05)


def costs(reader: Reader, sound: str, paths: Sequence[Path]) -> list[Row]:
    """The cost of each file in a process that has read a valid one before, and the length of its error."""
    call = f"import sys; from tests.floorplans.untrusted import *; main({reader.__name__}, *sys.argv[1:])"
    run = subprocess.run([sys.executable, "-c", call, sound, *paths], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr[-2000:]
    rows = [line.split(";") for line in run.stdout.splitlines()]
    assert len(rows) == len(paths)
    return [(float(s), float(mb), int(said), path.name) for (s, mb, said), path in zip(rows, paths, strict=True)]


def main(reader: Reader, sound: str, *names: str) -> None:
    """Print one row per file."""
    reader(sound)
    for name in names:
        said = list[str]()
        taken = cost(partial(_note_refusal, reader, name, said), SECONDS)
        print(taken.seconds, taken.megabytes, len(said[0]), sep=";")


def _note_refusal(reader: Reader, name: str, said: list[str]) -> None:
    """The error message of a refused file without its name; empty for a file that is read."""
    try:
        reader(name)
        said.append("")
    except LayoutError as error:
        said.append(str(error).removeprefix(name))
