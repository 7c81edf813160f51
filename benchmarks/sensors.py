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

from benchmarks.common import Figures, Gate, Options, runs_of, share
from benchmarks.drives import replay
from benchmarks.records import HARD, IN_MEMORY, Course, Records, on_records, place
from benchmarks.tables import columns_of, means, precision_and_recall, table_of
from mecp_env.slam.config import chi2_of_point

MAX_STEPS, FIRST_SEED, FIRST_BUILDING = 500, 2000, 950
LAYOUTS = ("furnished", HARD, "paper", "office")  # one after the other
ROWS: dict[str, dict[str, Any]] = {  # name -> fields of the environment
    "0.5 cm, 0.1 deg": {"laser": {"range_sigma_m": 0.005, "bearing_sigma_deg": 0.1}},
    "1 cm, 0.1 deg": {"laser": {"range_sigma_m": 0.01, "bearing_sigma_deg": 0.1}},
    "2 cm, 0.1 deg": {"laser": {"range_sigma_m": 0.02, "bearing_sigma_deg": 0.1}},
    "paper": {},
    "360 beams": {"laser": {"beams": 360}},
    "1080 beams": {"laser": {"beams": 1080}},
    "range 4 m": {"laser": {"max_range_m": 4.0}},
    "slip": {"odometry": {"preset": "skid_steer"}},
    **{name: {"laser": {"preset": name}} for name in ("ideal", "utm30lx", "lms200", "rplidar_a1", "urg04lx")},
}
ELLIPSE = chi2_of_point(0.9)
SETS = dict.fromkeys(ROWS, 16)
MEANS = ("nees", "landmark_nees", "pair_nees", "in_ellipse", "rmse_m")

GATES = tuple(Gate(f"{name}/nees", "bound", 4.0) for name in ROWS)


def run(options: Options) -> Figures:
    """Results of every sensor."""
    drives = sorted(runs_of(options, SETS), key=lambda drive: drive[1])  # a part of the time: a part of each sensor
    return {name: summarise(runs) for name, runs in on_records(counted, Figures, drives, options).items()}


def course(name: str, seed: int) -> Course:
    """What is driven with a sensor."""
    layout = LAYOUTS[seed % len(LAYOUTS)]
    where = place(layout, FIRST_BUILDING + seed)
    return Course(where, FIRST_SEED + seed, {"estimator": "truth", "max_steps": MAX_STEPS, **ROWS[name]})


def counted(drive_of: tuple[str, int], records: Records = IN_MEMORY) -> Figures:
    """Counts of the estimator on one drive."""
    drive = records.drive(course(*drive_of))
    outcome = replay(drive, drive.slam)
    return outcome.counts | {"in_ellipse": float((outcome.position_nees <= ELLIPSE).mean())}


def summarise(runs: list[Figures]) -> Figures:
    """Results of one sensor over its drives, each with its 95 % interval."""
    columns = columns_of(runs)
    return {**means(columns, *MEANS), **precision_and_recall(columns), "lost": share(columns["lost"] > 0)}


def report(figures: Figures) -> str:
    """One row per sensor."""
    columns = (*MEANS, "precision", "recall", "lost")
    n = max(row["nees"]["n"] for row in figures.values())
    return f"Drives per sensor: {n}.\n\n{table_of('sensor', columns, figures)}"
