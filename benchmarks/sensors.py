"""Consistency by sensor: does the estimator know how wrong its pose and its landmarks are, whatever the laser?

The robot explores with the true pose as the driver, for 500 control steps at most, in shipped layouts and generated
buildings of the test split; the whole estimator is run on what it records, with the settings of the defaults. Rows are
lasers: the presets, and that of the paper (IV) with other noise of range and bearing, another number of beams or a
short range; `slip` has wheels that slip in 1 % of the steps, of which the covariance of the odometry knows nothing.

`nees` is that of the pose (3 expected), `landmark_nees` that of the landmarks at the end (2 expected), and `pair_nees`
that of the offset of two of them that were matched in one scan (2 expected), all means over drives. `in_ellipse` is the
share of the scans in which the true position lies in the ellipse of 90 % around the estimate. `rmse_m` is that of the
pose. A drive is lost as in `noise`; its figures count.
"""

from __future__ import annotations

from typing import Any

from benchmarks.common import Figures, Options, runs_of
from benchmarks.drives import replay
from benchmarks.records import HARD, IN_MEMORY, Course, Records, on_records, place
from benchmarks.tables import summary

MAX_STEPS, FIRST_SEED, FIRST_BUILDING = 500, 2000, 950
LAYOUTS = ("furnished", HARD, "paper", "office")  # one after the other
ROWS: dict[str, dict[str, Any]] = {  # name -> fields of the environment
    **{
        f"{100.0 * sigma_m:g} cm, 0.1 deg": {"laser": {"range_sigma_m": sigma_m, "bearing_sigma_deg": 0.1}}
        for sigma_m in (0.005, 0.01, 0.02)
    },
    "paper": {},
    **{f"{beams} beams": {"laser": {"beams": beams}} for beams in (360, 1080)},
    "range 4 m": {"laser": {"max_range_m": 4.0}},
    "slip": {"odometry": {"preset": "skid_steer"}},
    **{name: {"laser": {"preset": name}} for name in ("ideal", "utm30lx", "lms200", "rplidar_a1", "urg04lx")},
}
SETS = dict.fromkeys(ROWS, 16)
COLUMNS = ("nees", "landmark_nees", "pair_nees", "in_ellipse", "rmse_m", "precision", "recall", "lost")


def run(options: Options) -> Figures:
    """Results of every sensor."""
    drives = sorted(runs_of(options, SETS), key=lambda drive: drive[1])  # a part of the time: a part of each sensor
    return {name: summary(runs, COLUMNS) for name, runs in on_records(counted, Figures, drives, options).items()}


def counted(drive_of: tuple[str, int], records: Records = IN_MEMORY) -> Figures:
    """Counts of the estimator on one drive with a sensor."""
    name, seed = drive_of
    where = place(LAYOUTS[seed % len(LAYOUTS)], FIRST_BUILDING + seed)
    fields = {"estimator": "truth", "max_steps": MAX_STEPS, **ROWS[name]}
    drive = records.drive(Course(where, FIRST_SEED + seed, fields))
    return replay(drive, drive.slam).counts
