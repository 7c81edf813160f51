"""How many cores this process may use: its affinity and the limits of its cgroups."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path

ROOT = Path("/")


def cores(root: Path = ROOT) -> int:
    """At least 1: the cores of the affinity, or fewer where a cgroup limits CPU time; a limit of 1.5 cores is 2."""
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min([allowed, *(math.ceil(limit) for limit in _limits(root))]))


def _limits(root: Path) -> Iterator[float]:
    """The CPU limits, in cores, of the cgroup of this process and of all that contain it (versions 1 and 2)."""
    try:
        groups = [line.split(":", 2) for line in (root / "proc/self/cgroup").read_text(encoding="utf-8").splitlines()]
    except OSError:  # not Linux
        return
    for _, controllers, path in groups:
        if controllers and "cpu" not in controllers.split(","):
            continue
        mount = root / "sys/fs/cgroup" / controllers
        group = mount / path.lstrip("/")
        for folder in (group, *group.parents[: len(group.relative_to(mount).parts)]):
            yield from _limit(folder)


def _limit(folder: Path) -> Iterator[float]:
    """The limit of one cgroup, if it has one; inside a container the folders of its host are missing."""
    try:
        if (folder / "cpu.max").exists():
            quota, period = (folder / "cpu.max").read_text(encoding="utf-8").split()
        else:
            quota, period = (
                (folder / f"cpu.cfs_{name}_us").read_text(encoding="utf-8").strip() for name in ("quota", "period")
            )
        if quota not in ("max", "-1"):
            yield float(quota) / float(period)
    except OSError:
        return
