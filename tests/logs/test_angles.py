"""Angles of the laser in degrees, where the format has rad: they are seen by their size, and named."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mecp_env.logs import read_log
from tests.logs.files import BEAMS, BEARINGS, bag_of, drive, joined, lines_of, write_archive

DEGREES = np.degrees(BEARINGS)


def archive(path: Path, angles: np.ndarray = DEGREES) -> Path:
    return write_archive(path.with_suffix(".npz"), angles=angles)


def carmen(path: Path, start: float = DEGREES[0], step: float = DEGREES[1] - DEGREES[0]) -> Path:
    def line(t: float, pose: np.ndarray, ranges: np.ndarray) -> str:
        head = f"RAWLASER1 0 {start:f} {step * (BEAMS - 1):f} {step:f} 30.0 0.01 0 {BEAMS}"
        return joined("ODOM", pose, "0 0 0", t, "robot 0") + "\n" + joined(head, ranges, 0, t, "robot 0")

    path = path.with_suffix(".log")
    path.write_text("\n".join(lines_of(*drive(), line)))
    return path


def start_alone(path: Path) -> Path:
    return carmen(path, step=BEARINGS[1] - BEARINGS[0])


def table(path: Path) -> Path:
    names = ",".join(f"r{k}" for k in range(BEAMS))
    rows = [joined(t, pose, DEGREES[0], DEGREES[1] - DEGREES[0], one) for t, pose, one in zip(*drive(), strict=True)]
    path = path.with_suffix(".csv")
    head = f"t,x,y,heading,angle_min,angle_increment,{names}"
    path.write_text("\n".join([head, *rows]).replace(" ", ","))
    return path


def bag(path: Path) -> Path:
    written = bag_of(path.with_suffix(".bag"))
    for scan in written.of("/scan"):
        for field in ("angle_min", "angle_max", "angle_increment"):
            object.__setattr__(scan, field, np.degrees(getattr(scan, field)))
    return written.close()


@pytest.mark.parametrize("write", [archive, carmen, start_alone, table, bag])
def test_angles_in_degrees_are_taken_as_such_and_named(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    log = read_log(write(tmp_path / "a"))
    np.testing.assert_allclose(log.bearings, BEARINGS, atol=1e-4)
    assert sum("angles of the laser are taken as degrees" in note for note in log.notes) == 1


def test_degrees_that_jump_by_a_turn(tmp_path: Path) -> None:
    log = read_log(archive(tmp_path / "a", DEGREES % 360.0))
    np.testing.assert_allclose(log.bearings, BEARINGS, atol=1e-6)
