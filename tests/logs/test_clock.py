"""Stamps that are equal, missing, or of no use: the order of the file counts, and nothing is left out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mecp_env.logs import Log, ReadOptions, read_log
from tests.logs.files import CARMEN, drive, flaser, write_archive


def written(path: Path, t: np.ndarray, line=flaser) -> Log:
    _, poses, ranges = drive(len(t))
    path.write_text("\n".join(line(*row) for row in zip(t, poses, ranges, strict=True)) + "\n")
    return read_log(path)


@pytest.mark.parametrize("line", CARMEN)
@pytest.mark.parametrize("stamp", [0.0, 4.29497e9, -1.0, 4.85114e-86])
def test_equal_stamps(tmp_path: Path, line: str, stamp: float) -> None:
    log = written(tmp_path / "a.log", np.full(40, stamp), CARMEN[line])
    assert len(log) == log.found == 40
    assert log.counts["scans without a useful stamp, in the order of the file"] == 40
    assert any("order of the file" in note for note in log.notes)
    np.testing.assert_allclose(log.T_odom_robot, drive(40)[1], atol=1e-5)


def test_lines_without_stamps(tmp_path: Path) -> None:
    _, poses, ranges = drive(40)
    lines = [flaser(0.0, pose, one).rsplit(" ", 3)[0] for pose, one in zip(poses, ranges, strict=True)]
    (tmp_path / "a.log").write_text("\n".join(lines))
    log = read_log(tmp_path / "a.log")
    assert len(log) == log.counts["lines without a stamp"] == 40
    np.testing.assert_allclose(log.T_odom_robot, poses, atol=1e-5)


@pytest.mark.parametrize("order", [lambda t: t[::-1], lambda t: np.tile(t[:20], 2), lambda t: np.roll(t, 10)])
def test_clocks_that_run_backwards_or_start_again(tmp_path: Path, order) -> None:
    log = written(tmp_path / "a.log", order(drive(40)[0]))
    assert len(log) == 40
    assert (np.diff(log.t) > 0.0).all()
    np.testing.assert_allclose(log.T_odom_robot, drive(40)[1], atol=1e-5)


def test_stamps_of_whole_seconds_are_spread(tmp_path: Path) -> None:
    t = drive(40)[0]
    log = written(tmp_path / "a.log", np.floor(t))
    assert log.counts["scans with the stamp of another"] == 30
    np.testing.assert_allclose(log.t, t, atol=1e-6)


def test_archives(tmp_path: Path) -> None:
    log = read_log(write_archive(tmp_path / "a.npz", t=np.zeros(12), rel=None))
    assert len(log) == 12
    np.testing.assert_allclose(log.T_ref_robot, drive()[1], atol=1e-9)


def test_the_order_of_the_file_can_be_asked_for(tmp_path: Path) -> None:
    log = read_log(write_archive(tmp_path / "a.npz"), ReadOptions(clock="received"))
    np.testing.assert_array_equal(log.t, np.arange(12.0))


@pytest.mark.parametrize("unit", [1e-3, 1e-6, 1e-9])
def test_stamps_since_1970_in_other_units(tmp_path: Path, unit: float) -> None:
    t = 1.7e9 + drive()[0]
    log = read_log(write_archive(tmp_path / "a.npz", t=t / unit, rel=np.array([[t[0] / unit, t[4] / unit, 1, 0, 0]])))
    np.testing.assert_allclose(log.t, t, atol=1e-5)
    np.testing.assert_allclose(log.relations[0, :2], t[[0, 4]], atol=1e-5)
    assert f"stamps are taken in units of {unit:.0e} s" in log.notes
