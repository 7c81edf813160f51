"""Small files that would take gigabytes are refused before it is made."""

from __future__ import annotations

import gzip
import io
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from mecp_env.core.errors import LogError
from mecp_env.logs import read_log

MOST_BYTES = 180_000_000
LINE = b"FLASER 8 1 1 1 1 1 1 1 1 0 0 0 0 0 0 1\n"


def packed_lines(path: Path) -> None:
    with gzip.open(path, "wb", compresslevel=9) as file:
        for _ in range(300):
            file.write(LINE * 10_000)


def empty_lines(path: Path) -> None:
    with gzip.open(path, "wb", compresslevel=9) as file:
        for _ in range(200):
            file.write(b"\n" * 10**6)


def short_lines(path: Path) -> None:
    with gzip.open(path, "wb", compresslevel=9) as file:
        for _ in range(20):
            file.write(b"x\n" * 10**6)


def zeros(path: Path) -> None:
    np.savez_compressed(path, t=np.arange(4000.0), ranges=np.zeros((4000, 2000), np.uint8), angles=np.arange(2000.0))


def huge_shape(path: Path) -> None:
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "|u1", "fortran_order": False, "shape": (10**12,)})
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("t", "ranges", "angles"):
            archive.writestr(f"{name}.npy", head.getvalue())


@pytest.mark.parametrize("packing", ["bz2", "lz4"])
def test_packed_chunks(tmp_path: Path, packing: str) -> None:
    rosbag1 = pytest.importorskip("rosbags.rosbag1")
    sound, large = tmp_path / "a.bag", tmp_path / "b.bag"
    for path, size in ((sound, 1000), (large, 80_000_000)):
        writer = rosbag1.Writer(path)
        writer.set_compression(rosbag1.Writer.CompressionFormat[packing.upper()])
        with writer:
            end = writer.add_connection(
                "/x", "std_msgs/msg/Int8", msgdef="int8 data", md5sum="27ffa0c9c4b8fb8492252bcad9e5c57b"
            )
            writer.write(end, 1, bytes(size))
    with pytest.raises(LogError, match="chunk unpacks"):
        read_log(large)
    with pytest.raises(LogError, match="no laser"):
        read_log(sound)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("a.log.gz", packed_lines),
        ("a.log.gz", empty_lines),
        ("a.log.gz", short_lines),
        ("a.npz", zeros),
        ("a.npz", huge_shape),
    ],
)
def test_bombs(tmp_path: Path, name: str, write) -> None:
    write(tmp_path / name)
    tracemalloc.start()
    with pytest.raises(LogError, match=name):
        read_log(tmp_path / name)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < MOST_BYTES


@pytest.mark.parametrize(
    ("storage", "mode"), [(s, m) for s in ("MCAP", "SQLITE3") for m in ("MESSAGE", "FILE", "STORAGE")]
)
def test_packed_parts_of_ros2_bags(storage: str, mode: str, tmp_path: Path) -> None:
    rosbag2, typesys = pytest.importorskip("rosbags.rosbag2"), pytest.importorskip("rosbags.typesys")
    if (storage, mode) == ("SQLITE3", "STORAGE"):
        pytest.skip("databases are not packed")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    for size, words in ((80_000_000, "chunk unpacks"), (1000, "no scan that can be used")):
        writer = rosbag2.Writer(tmp_path / str(size), version=9, storage_plugin=rosbag2.StoragePlugin[storage])
        writer.set_compression(rosbag2.CompressionMode[mode], rosbag2.CompressionFormat.ZSTD)
        with writer:
            end = writer.add_connection("/scan", "sensor_msgs/msg/LaserScan", typestore=store)
            for stamp in range(2):
                writer.write(end, stamp, bytes(size))
        tracemalloc.start()
        with pytest.raises(LogError, match=words):
            read_log(tmp_path / str(size))
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < MOST_BYTES
