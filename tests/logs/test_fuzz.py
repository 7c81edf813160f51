"""1,200 mutated logs of all formats: each is read with what is left of it counted, or refused with a `LogError`."""

from __future__ import annotations

import random
import resource
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mecp_env.core.errors import LogError
from mecp_env.evaluation.log_run import LogRunConfig, run_log
from mecp_env.logs import read_log
from tests.logs.files import CARMEN, write_archive, write_bag, write_carmen

MOST_S, MOST_MIB = 5.0, 400  # of one file; of all files of a test beside what was in use before
EVERY = 25  # so many logs that could be read, one is also given to the estimator
NUMBERS = (b"nan", b"-inf", b"1e308", b"-1", b"0", b"999999999999", b"3.7", b"x")


Ways = tuple[Callable[[bytes, random.Random], bytes], ...]


def truncated(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data))]


def flipped(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 3, 30))):
        changed[rng.randrange(len(data))] = rng.randrange(256)
    return bytes(changed)


def garbage(data: bytes, rng: random.Random) -> bytes:
    at, length = rng.randrange(len(data)), rng.randrange(1, 2000)
    return data[:at] + rng.randbytes(length) + data[at + rng.choice((0, length)) :]


def cut_out(data: bytes, rng: random.Random) -> bytes:
    first, last = sorted((rng.randrange(len(data)), rng.randrange(len(data))))
    return data[:first] + data[last:]


def swapped_lines(data: bytes, rng: random.Random) -> bytes:
    lines = data.split(b"\n")
    for _ in range(rng.choice((1, 5, 50))):
        a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
        lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


def doubled_lines(data: bytes, rng: random.Random) -> bytes:
    lines = data.split(b"\n")
    return b"\n".join(line for line in lines for _ in range(rng.choice((0, 1, 1, 1, 2))))


def other_numbers(data: bytes, rng: random.Random) -> bytes:
    words = data.split(b" ")
    for _ in range(rng.choice((1, 5, 50))):
        words[rng.randrange(len(words))] = rng.choice(NUMBERS)
    return b" ".join(words)


BYTES = (truncated, flipped, flipped, garbage, cut_out)
TEXT = (truncated, flipped, garbage, cut_out, swapped_lines, doubled_lines, other_numbers, other_numbers)


def check(path: Path, tried: list[str]) -> None:
    """Read a log, and let the estimator run on some of them."""
    start = time.process_time()
    try:
        log = read_log(path)
        assert len(log) >= 1
        assert (np.diff(log.t) > 0.0).all()
        assert log.max_range_m > 0.0
        tried.append("counted" if log.counts else "sound")
        if len(tried) % EVERY == 0:
            run_log(log, run=LogRunConfig(odometry="reference" if log.T_odom_robot is None else "log")).metrics()
    except LogError:
        tried.append("refused")
    assert time.process_time() - start < MOST_S


def fuzz(source: Path, target: Path, count: int, ways: Ways, read: Path | None = None) -> list[str]:
    """What became of mutated files, or of folders to `read` in which one file is mutated."""
    rng, data, before = random.Random(count), source.read_bytes(), peak_mib()
    tried: list[str] = []
    for _ in range(count):
        target.write_bytes(rng.choice(ways)(data, rng))
        check(read or target, tried)
    assert peak_mib() - before < MOST_MIB
    return tried


def peak_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


@pytest.fixture(scope="module", autouse=True)
def compiled(tmp_path_factory: pytest.TempPathFactory) -> None:
    """The estimator is compiled before seconds count."""
    run_log(read_log(write_archive(tmp_path_factory.mktemp("sound") / "a.npz")))


@pytest.mark.parametrize("line", CARMEN)
def test_carmen(tmp_path: Path, line: str) -> None:
    tried = fuzz(write_carmen(tmp_path / "a.log", CARMEN[line]), tmp_path / "b.log", 120, TEXT)
    assert tried.count("counted") > 48


def test_archive_and_folder_of_a_bag(tmp_path: Path) -> None:
    assert "refused" in fuzz(write_archive(tmp_path / "a.npz"), tmp_path / "b.npz", 150, BYTES)
    pytest.importorskip("rosbags")
    folder = write_bag(tmp_path / "a")
    assert "refused" in fuzz(folder / "metadata.yaml", folder / "metadata.yaml", 50, TEXT, folder)


def test_arrays_with_other_numbers(tmp_path: Path) -> None:
    rng, tried = np.random.default_rng(0), list[str]()
    arrays = dict(np.load(write_archive(tmp_path / "a.npz")))
    for _ in range(120):
        name = str(rng.choice(list(arrays)))
        changed = arrays[name].copy()
        where = rng.random(changed.shape) < rng.choice([0.02, 0.3, 1.0])
        changed[where] = rng.choice([np.nan, np.inf, -1.0, 1e300, 0.0, 5.0])
        np.savez(tmp_path / "b.npz", **(arrays | {name: changed}))
        check(tmp_path / "b.npz", tried)
    assert tried.count("counted") > 60


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".bag", ".db3", ".mcap"])
def test_bag(tmp_path: Path, suffix: str) -> None:
    pytest.importorskip("rosbags")
    tried = fuzz(write_bag(tmp_path / f"a{suffix}"), tmp_path / f"b{suffix}", 140, BYTES)
    assert {"refused", "counted"} & set(tried)
