"""How many cores this process may use: affinity and cgroup limits of both versions, from files as Linux writes them."""

import os
from pathlib import Path

import pytest

from mecp_env.core.processes import cores

FOUR = {0, 1, 2, 3}


def write(root: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


@pytest.fixture(autouse=True)
def _four_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: FOUR, raising=False)


def v2(path: str, **limits: str) -> dict[str, str]:
    """The files of a process in a cgroup of version 2; the limit of each group by the last letter of its path."""
    groups = {"root": "", "a": "/a", "b": "/a/b"}
    files = {f"sys/fs/cgroup{groups[name]}/cpu.max": f"{quota} 100000\n" for name, quota in limits.items()}
    return files | {"proc/self/cgroup": f"0::{path}\n"}


def v1(quota: str) -> dict[str, str]:
    """The same of version 1."""
    folder = "sys/fs/cgroup/cpu,cpuacct/a/b/cpu.cfs_"
    files = {f"{folder}quota_us": f"{quota}\n", f"{folder}period_us": "100000\n"}
    return files | {"proc/self/cgroup": "12:memory:/a/b\n4:cpu,cpuacct:/a/b\n"}


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({}, 4),  # not Linux
        (v2("/"), 4),
        (v2("/a", a="max"), 4),
        (v2("/a", a="150000"), 2),
        (v2("/a", a="20000"), 1),
        (v2("/a", a="900000"), 4),
        (v2("/a/b", a="300000", b="max"), 3),  # the limit of a group around it
        (v2("/docker/1f", root="200000"), 2),  # in a container: its group is mounted as the root
        (v1("250000"), 3),
        (v1("-1"), 4),
    ],
)
def test_the_smallest_limit_counts(tmp_path: Path, files: dict[str, str], expected: int) -> None:
    assert cores(write(tmp_path, files)) == expected


def test_the_affinity_counts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {5}, raising=False)
    assert cores(write(tmp_path, v2("/a", a="300000"))) == 1
    assert cores() == 1
