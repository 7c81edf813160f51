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

MOST_BYTES, LARGE = 180_000_000, 50_000_000
LINES = {"sound": (b"FLASER 8 1 1 1 1 1 1 1 1 0 0 0 0 0 0 1\n" * 10_000, 300)}
LINES |= {"empty": (b"\n" * 10**6, 200), "short": (b"x\n" * 10**6, 20)}


def refused(path: Path, said: str) -> None:
    """Within the memory."""
    tracemalloc.start()
    with pytest.raises(LogError, match=said):
        read_log(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < MOST_BYTES


@pytest.mark.slow
@pytest.mark.parametrize("name", LINES)
def test_bombs_of_lines(tmp_path: Path, name: str) -> None:
    lines, times = LINES[name]
    with gzip.open(tmp_path / "a.log.gz", "wb", compresslevel=9) as file:
        for _ in range(times):
            file.write(lines)
    refused(tmp_path / "a.log.gz", "a.log.gz")


@pytest.mark.slow
def test_bombs_of_arrays(tmp_path: Path) -> None:
    many = {"t": np.arange(4000.0), "ranges": np.zeros((4000, 2000), np.uint8), "angles": np.arange(2000.0)}
    np.savez_compressed(tmp_path / "a.npz", **many)
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "|u1", "fortran_order": False, "shape": (10**12,)})
    with zipfile.ZipFile(tmp_path / "b.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        for name in many:
            archive.writestr(f"{name}.npy", head.getvalue())
    refused(tmp_path / "a.npz", "a.npz")
    refused(tmp_path / "b.npz", "b.npz")


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
