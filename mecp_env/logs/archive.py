"""Logs as NumPy archives: t, ranges, angles, and ref, odo, rel, max_range_m, mount where there are any."""

from __future__ import annotations

import io
import math
import zipfile
from pathlib import Path

import numpy as np

from mecp_env.core.array_types import Array
from mecp_env.core.errors import LogError
from mecp_env.core.paths import read_bytes
from mecp_env.logs.recording import Budget, Geometry, Recording, Sweep, Track

MOST_BYTES = 2**31  # of the file, and unpacked
SHAPES = {  # n scans of B beams
    "t": ("n",),
    "ranges": ("n", "B"),
    "angles": ("B",),
    "ref": ("n", 3),
    "odo": ("n", 3),
    "rel": ("k", 5),
    "max_range_m": (),
    "mount": (3,),
}
NEEDED = ("t", "ranges", "angles")
UNEVEN = 0.25  # of a step, by which an angle may be off


def read_archive(path: Path) -> Recording:
    """What is in an archive. Raises `LogError`."""
    data = read_bytes(path, MOST_BYTES)
    recording = Recording(path.name, budget=Budget.of(len(data)))
    arrays = _arrays(data, recording.budget)
    _check_shapes(arrays)
    geometry = _geometry(arrays["angles"], float(arrays.get("max_range_m", np.array(np.inf))))
    stamps = arrays["t"].tolist()
    stamps, odometry = arrays["t"].tolist(), arrays.get("odo", np.empty((0, 3)))
    poses = list(odometry) or [None] * len(stamps)
    for row, (t, sweep, pose) in enumerate(zip(stamps, arrays["ranges"], poses, strict=True)):
        recording.add(Sweep(t, sweep, geometry, pose, order=float(row)))
    if "ref" in arrays:
        recording.reference = Track(stamps, list(arrays["ref"]), [float(row) for row in range(len(stamps))])
    relations = arrays.get("rel", recording.relations)
    recording.relations = relations[np.isfinite(relations).all(axis=1)]
    recording.counts["damaged relations"] += len(relations) - len(recording.relations)
    recording.T_robot_laser = arrays.get("mount")
    return recording


def _arrays(data: bytes, budget: Budget) -> dict[str, Array]:
    """The arrays of known names, as numbers. Raises `LogError`."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for member in archive.infolist():
                if member.filename.removesuffix(".npy") in SHAPES:
                    _check_size(archive, member, budget)
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            _check_names(list(archive))
            return {name: np.array(archive[name], np.float64) for name in SHAPES if name in archive}
    except LogError:
        raise
    except Exception as error:  # damaged bytes may raise anything
        raise LogError(f"no NumPy archive, or damaged ({type(error).__name__}: {error!s:.80})") from None


def _check_size(archive: zipfile.ZipFile, member: zipfile.ZipInfo, budget: Budget) -> None:
    """Spend what an array takes as it is and as numbers. Raises `LogError` before it is unpacked."""
    with archive.open(member) as file:
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, kind = read(file)
    if kind.hasobject:
        raise LogError(f"{member.filename}: damaged, or Python objects instead of numbers")
    counted_again = 8 if member.filename == "ranges.npy" else 0  # with the sweeps
    budget.take(math.prod(shape) * (max(kind.itemsize, 8) - counted_again))


def _check_names(names: list[str]) -> None:
    """Raise `LogError` where an array is missing."""
    missing = [name for name in NEEDED if name not in names]
    if missing:
        there = f"{', '.join(names):.120}" or "nothing"
        raise LogError(f"no {', '.join(missing)} in the archive, only {there} (expected: {', '.join(SHAPES)})")


def _check_shapes(arrays: dict[str, Array]) -> None:
    """Raise `LogError` for arrays of other shapes than `SHAPES`, whose letters stand for one length each."""
    lengths: dict[str, int] = {}
    for name, values in arrays.items():
        expected = SHAPES[name]
        fits = values.ndim == len(expected) and all(
            size == (lengths.setdefault(length, size) if isinstance(length, str) else length)
            for size, length in zip(values.shape, expected, strict=True)
        )
        if not fits:
            where = ", ".join(f"{letter} = {length}" for letter, length in lengths.items())
            shape = f"({', '.join(map(str, expected))})"
            raise LogError(f"{name}: shape {values.shape}, {shape} expected" + (f" with {where}" if where else ""))


def _geometry(angles: Array, max_range_m: float) -> Geometry:
    """That of angles (B,), which are evenly spaced. Raises `LogError`."""
    if len(angles) < 2 or not np.isfinite(angles).all():
        raise LogError(f"angles: {len(angles)} finite numbers, at least 2 expected")
    even = np.linspace(angles[0], angles[-1], len(angles))
    if abs(angles - even).max() > UNEVEN * abs(even[1] - even[0]):
        raise LogError("angles: not evenly spaced")
    return Geometry(len(angles), float(even[0]), float(even[1] - even[0]), 0.0, max_range_m)
