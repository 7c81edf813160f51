"""1,100 mutated logs of all formats: each is read with what is left of it counted, or refused with a `LogError`.

Small files that would take gigabytes are refused before it is made. `benchmarks/mutated_files.py` also maps such logs.
"""

import io
import random
import resource
import time
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mecp_env.core.errors import LogError
from mecp_env.logs import read_log
from tests.logs.files import CARMEN, write_archive, write_bag, write_carmen

MOST_S, MOST_MIB = 5.0, 400  # of one file; of all files of a test beside what was in use before
MOST_BYTES, LARGE = 180_000_000, 50_000_000  # when a small file is refused that unpacks to much
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
    """Other bytes in the place of some, or of none; or nothing in their place."""
    at, length = rng.randrange(len(data)), rng.randrange(1, 2000)
    return data[:at] + rng.choice((b"", rng.randbytes(length))) + data[at + rng.choice((0, length, 20 * length)) :]


def other_lines(data: bytes, rng: random.Random) -> bytes:
    """Some lines are missing, there twice, or in the place of others."""
    lines = data.split(b"\n")
    for _ in range(rng.choice((1, 5, 50))):
        lines[rng.randrange(len(lines))] = rng.choice((b"", rng.choice(lines), b"\n".join(rng.choices(lines, k=2))))
    return b"\n".join(lines)


def other_numbers(data: bytes, rng: random.Random) -> bytes:
    words = data.split(b" ")
    for _ in range(rng.choice((1, 5, 50))):
        words[rng.randrange(len(words))] = rng.choice(NUMBERS)
    return b" ".join(words)


BYTES = (truncated, flipped, garbage)
TEXT = (truncated, flipped, garbage, other_lines, other_numbers)


def check(path: Path, tried: list[str]) -> None:
    """Read a log, or refuse it."""
    start = time.process_time()
    try:
        log = read_log(path)
        assert len(log) >= 1
        assert (np.diff(log.t) > 0.0).all()
        assert log.max_range_m > 0.0
        tried.append("counted" if log.counts else "sound")
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


@pytest.mark.parametrize("line", CARMEN)
def test_carmen(tmp_path: Path, line: str) -> None:
    tried = fuzz(write_carmen(tmp_path / "a.log", CARMEN[line]), tmp_path / "b.log", 120, TEXT)
    assert tried.count("counted") > 48


def test_archive_and_folder_of_a_bag(tmp_path: Path) -> None:
    assert "refused" in fuzz(write_archive(tmp_path / "a.npz"), tmp_path / "b.npz", 150, BYTES)
    pytest.importorskip("rosbags")
    folder = write_bag(tmp_path / "a")
    assert "refused" in fuzz(folder / "metadata.yaml", folder / "metadata.yaml", 50, TEXT, folder)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".bag", ".db3", ".mcap"])
def test_bag(tmp_path: Path, suffix: str) -> None:
    pytest.importorskip("rosbags")
    tried = fuzz(write_bag(tmp_path / f"a{suffix}"), tmp_path / f"b{suffix}", 140, BYTES)
    assert {"refused", "counted"} & set(tried)


def refused(path: Path, said: str) -> None:
    """Within the memory."""
    tracemalloc.start()
    with pytest.raises(LogError, match=said):
        read_log(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < MOST_BYTES


def test_arrays_that_claim_to_be_large(tmp_path: Path) -> None:
    """Files of many lines or numbers are those of tests/core/test_file_memory.py."""
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "|u1", "fortran_order": False, "shape": (10**12,)})
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("t", "ranges", "angles"):
            archive.writestr(f"{name}.npy", head.getvalue())
    refused(tmp_path / "a.npz", "a.npz")


@pytest.mark.parametrize("packing", ["BZ2", "LZ4"])
def test_packed_chunks(tmp_path: Path, packing: str) -> None:
    rosbag1 = pytest.importorskip("rosbags.rosbag1")
    for size, said in ((LARGE, "chunk unpacks"), (1000, "no laser")):
        writer = rosbag1.Writer(tmp_path / f"{size}.bag")
        writer.set_compression(rosbag1.Writer.CompressionFormat[packing])
        with writer:
            kind = {"msgdef": "int8 data", "md5sum": "27ffa0c9c4b8fb8492252bcad9e5c57b"}
            writer.write(writer.add_connection("/x", "std_msgs/msg/Int8", **kind), 1, bytes(size))
        refused(tmp_path / f"{size}.bag", said)


@pytest.mark.parametrize(  # databases are not packed as a whole
    ("storage", "mode"),
    [("MCAP", "MESSAGE"), ("MCAP", "FILE"), ("MCAP", "STORAGE"), ("SQLITE3", "MESSAGE"), ("SQLITE3", "FILE")],
)
def test_packed_parts_of_ros2_bags(storage: str, mode: str, tmp_path: Path) -> None:
    rosbag2, typesys = pytest.importorskip("rosbags.rosbag2"), pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    for size, said in ((LARGE, "chunk unpacks"), (1000, "no scan that can be used")):
        writer = rosbag2.Writer(tmp_path / str(size), version=9, storage_plugin=rosbag2.StoragePlugin[storage])
        writer.set_compression(rosbag2.CompressionMode[mode], rosbag2.CompressionFormat.ZSTD)
        with writer:
            end = writer.add_connection("/scan", "sensor_msgs/msg/LaserScan", typestore=store)
            for stamp in range(2):
                writer.write(end, stamp, bytes(size))
        refused(tmp_path / str(size), said)
