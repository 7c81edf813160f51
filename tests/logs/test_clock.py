"""Stamps that are equal, missing, or of no use: the order of the file counts, and nothing is left out."""

from pathlib import Path

import numpy as np
import pytest

from mecp_env.logs import Log, ReadOptions, read_log
from tests.logs.files import CARMEN, check_path, drive, flaser, lines_of, read_lines, write_archive

LONG = drive(40)


def stamped(folder: Path, t: np.ndarray, line=flaser) -> Log:
    """A drive of 40 scans with these stamps; its odometry is as ever."""
    log = read_lines(folder, lines_of(t, *LONG[1:], line))
    assert len(log) == log.found == 40
    check_path(log, LONG[1])
    return log


@pytest.mark.parametrize("line", CARMEN)
def test_equal_stamps(tmp_path: Path, line: str) -> None:
    for stamp in (0.0, 4.29497e9, -1.0, 4.85114e-86):
        log = stamped(tmp_path, np.full(40, stamp), CARMEN[line])
        assert log.counts["scans without a useful stamp, in the order of the file"] == 40
        assert any("order of the file" in note for note in log.notes)


def test_lines_without_stamps(tmp_path: Path) -> None:
    log = read_lines(tmp_path, [line.rsplit(" ", 3)[0] for line in lines_of(*LONG)])
    assert len(log) == log.counts["lines without a stamp"] == 40
    check_path(log, LONG[1])


def test_clocks_that_run_backwards_start_again_or_count_whole_seconds(tmp_path: Path) -> None:
    t = LONG[0]
    for order in (t[::-1], np.tile(t[:20], 2), np.roll(t, 10)):
        assert (np.diff(stamped(tmp_path, order).t) > 0.0).all()
    log = stamped(tmp_path, np.floor(t))
    assert log.counts["scans with the stamp of another"] == 30
    np.testing.assert_allclose(log.t, t, atol=1e-6)


def test_stamps_that_repeat_or_are_impossible(tmp_path: Path) -> None:
    lines = lines_of(*drive())
    log = read_lines(tmp_path, [*lines[:3], lines[4], lines[3], *lines[5:], lines[-1]])
    assert (np.diff(log.t) > 0.0).all()
    assert log.counts["scans that repeat the one before"] == 1
    assert log.counts["scans with an impossible stamp, or out of order, placed by their lines"] == 1
    assert len(log) == log.found - 1 == 12
    t = LONG[0].copy()
    t[4], t[7] = 9e9, -5.0
    assert (np.diff(stamped(tmp_path, t).t) > 0.0).all()


def test_archives(tmp_path: Path) -> None:
    log = read_log(write_archive(tmp_path / "a.npz", t=np.zeros(12), rel=None))
    np.testing.assert_allclose(log.T_ref_robot, drive()[1], atol=1e-9)
    log = read_log(write_archive(tmp_path / "b.npz"), ReadOptions(clock="received"))  # the order of the file
    np.testing.assert_array_equal(log.t, np.arange(12.0))


@pytest.mark.parametrize("start", [0.0, 1.7e9])
@pytest.mark.parametrize("unit", [1e-3, 1e-6, 1e-9])
def test_stamps_in_other_units_since_1970_or_the_start(tmp_path: Path, unit: float, start: float) -> None:
    t = start + drive()[0]
    log = read_log(write_archive(tmp_path / "a.npz", t=t / unit, rel=np.array([[t[0] / unit, t[4] / unit, 1, 0, 0]])))
    np.testing.assert_allclose(log.t, t, atol=1e-5)
    np.testing.assert_allclose(log.relations[0, :2], t[[0, 4]], atol=1e-5)
    assert f"stamps are taken in units of {unit:.0e} s" in log.notes


def test_a_scan_each_10_s_is_none_each_10_ms_where_the_robot_would_be_too_fast(tmp_path: Path) -> None:
    t = 40.0 * drive()[0]
    log = read_log(write_archive(tmp_path / "a.npz", t=t))
    np.testing.assert_allclose(log.t, t)
    assert not log.notes
