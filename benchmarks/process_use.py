"""What processes use, from /proc: CPU time, memory, open files and shared memory; nan or 0 where there is no /proc."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

OWN = ("Pss_Anon", "Pss_Shmem")  # pages: not of files of libraries, which are divided among all programs that run
SHARED = re.compile(r"^\S+ ...s \S+ \S+ (\d+)", re.MULTILINE)  # the inode of a mapping that processes share


def processor_s(pids: Iterable[int | str]) -> float:
    """CPU seconds of all threads of the processes until now."""
    try:
        threads = [thread for pid in pids for thread in Path(f"/proc/{pid}/task").iterdir()]
        return sum(int((thread / "schedstat").read_text().split()[0]) for thread in threads) / 1e9
    except OSError:
        return float("nan")


def memory_mb(pids: Iterable[int | str], kinds: Sequence[str] = ("Pss",)) -> float:
    """Memory of the processes with shared pages divided; of some kinds of pages."""
    try:
        pages = [Path(f"/proc/{pid}/smaps_rollup").read_text() for pid in pids]
        return sum(int(re.findall(rf"\n{kind}:\s+(\d+)", page)[0]) for page in pages for kind in kinds) / 1e3
    except (OSError, IndexError):  # an old Linux has no Pss_Anon
        return float("nan")


def open_files(pids: Iterable[int | str]) -> int:
    """Open file descriptors of the processes."""
    folders = [Path(f"/proc/{pid}/fd") for pid in pids]
    return sum(len(list(folder.iterdir())) for folder in folders if folder.is_dir())


def shared_segments(pids: Iterable[int | str]) -> int:
    """Segments of shared memory that the processes have mapped, each counted once."""
    maps = [path.read_text() for path in (Path(f"/proc/{pid}/maps") for pid in pids) if path.exists()]
    return len({inode for text in maps for inode in SHARED.findall(text)})
