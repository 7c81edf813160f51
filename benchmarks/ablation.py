"""What each rule and threshold of the estimator is worth: switched off, halved and doubled, one at a time.

Every switch of the configuration is turned round, every number is halved and doubled as far as its bounds allow; only
what describes the sensor is left as it is. `--quick` has the switches alone. All variants run on the same drives,
recorded with the true pose as the driver. The cells are those of `noise` (`odometry_x1`, `odometry_x4`, `range_4_m`,
`slip_5_pct`), generated buildings (`hard`, with pedestrians and boxes in `people`), buildings and robots of the task
`ActiveHalls-v0` (`halls`), three floors of KTH (`kth`), recorded logs (`logs`: Intel, CSAIL, the first 1,000 scans of
fr079; path errors online and smoothed, share of scans without a known pose), and `rough`: scans against a finished map
at 2 m and 20 degrees (`loop`). Plans and logs are those of `shared/data` beside the repository; without them, their
cells are left out. A table has the mean differences to the default whose 95 % interval excludes 0; an error and the
number of wrong pairs are better below 0, recall and the share of right scans above. `same bits` are variants that
change no figure of any drive.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache, partial
from typing import Any, get_args

import numpy as np

from benchmarks import loop, noise, real_logs
from benchmarks.common import Figures, Options, estimate, grouped, in_parallel, runs_of, shared_data
from benchmarks.drives import Drive, replay
from benchmarks.real_logs import LOGS
from benchmarks.records import HARD, IN_MEMORY, KTH, Course, Records, kth_plans
from benchmarks.rough_pose import count_scans, drawn_looks, finish
from benchmarks.tables import columns_of, flatten, table
from benchmarks.variants import with_change
from mecp_env.core.errors import ConfigError
from mecp_env.episode.tasks import TASKS
from mecp_env.evaluation.log_run import config_for, run_log
from mecp_env.slam.association import make_associator
from mecp_env.slam.config import SlamConfig

PEOPLE, HALLS, LOG, ROUGH, TASK = "people", "halls", "logs", "rough", "ActiveHalls-v0"
SETS = dict.fromkeys(("odometry_x1", "odometry_x4", "range_4_m", "slip_5_pct", HARD, PEOPLE, HALLS), 4)
SETS |= {KTH: 3, LOG: 3, ROUGH: 6}
FIRST_SEED, FIRST_BUILDING = 60, 800  # after those that other benchmarks are judged by
EXPLORED: dict[str, tuple[str, dict[str, Any]]] = {  # cell -> buildings of its drives, fields of the environment
    HARD: (HARD, {}),
    PEOPLE: (HARD, {"crowd": {"people": 4}, "clutter": {"movable_boxes": 4}}),
    HALLS: (TASK, {name: TASKS[TASK][name] for name in ("laser", "odometry", "slam")}),
    KTH: (KTH, {}),
}
QUICK_DRIVES, LOG_SCANS = 3, 1000
ROUGH_SETS = ("paper", "hard", "twins")
DEFAULT = "default"
NUMBERS = (" halved", " doubled", " 1")  # what `--quick` leaves out
Row = dict[str, float]


def changes() -> dict[str, dict[str, Any]]:
    """Each variant by name: fields of sections of the configuration; the default has none."""
    found: dict[str, dict[str, Any]] = {DEFAULT: {}} | {
        f"{section}.{name} {label}": {section: {name: other}}
        for section, settings in SlamConfig.model_fields.items()
        if section != "sensor"
        for name, field in type(settings.default).model_fields.items()
        for label, other in variants_of(getattr(settings.default, name), field.annotation)
    }
    return {name: change for name, change in found.items() if is_valid(change)}


def variants_of(value: Any, annotation: Any) -> list[tuple[str, Any]]:
    """Other values of a field, with their labels: a switch turned round, a number halved and doubled, other words."""
    if isinstance(value, bool):
        return [("off" if value else "on", not value)]
    if isinstance(value, int | float):
        halved = value // 2 if isinstance(value, int) else 0.5 * value
        twice = [("doubled", 2 * value)] if value else [("1", 1)] if isinstance(value, int) else []
        return [("halved", halved)] * bool(halved) + twice
    return [(str(word), word) for word in get_args(annotation) if isinstance(word, str) and word != value]


def is_valid(change: dict[str, Any]) -> bool:
    """Whether the configuration allows a change."""
    try:
        with_change(SlamConfig(), change)
    except (ConfigError, ValueError):
        return False
    return True


def run(options: Options) -> Figures:
    """The differences of each variant to the default, per cell."""
    runs = runs_of(options, SETS, QUICK_DRIVES)
    drives = [(cell, FIRST_SEED + number) for cell, number in runs if is_there(cell)]
    names = [name for name in changes() if not options.quick or not name.endswith(NUMBERS)]
    units = [(cell, seed, name) for cell, seed in drives for name in names]
    task = partial(measure, records=Records(options.records))
    rows = dict(zip(units, in_parallel(task, Row, units, options), strict=True))
    figures: Figures = {name: {} for name in names[1:]}
    for cell, of in grouped(drives, drives).items():
        for name in figures:
            own, usual = (columns_of([rows[*drive, row] for drive in of]) for row in (name, DEFAULT))
            figures[name][cell] = {key: estimate(own[key] - usual[key]) for key in usual}
    return figures


def is_there(cell: str) -> bool:
    """Whether there are data for a cell."""
    return bool(kth_plans()) if cell == KTH else cell != LOG or shared_data("logs") is not None


def measure(task: tuple[str, int, str], records: Records = IN_MEMORY) -> Row:
    """The figures of one variant on one drive of a cell."""
    cell, seed, name = task
    change = changes()[name]
    if cell == ROUGH:
        return roughly(records, seed, change)
    if cell == LOG:
        return on_log(tuple(LOGS)[(seed - FIRST_SEED) % len(LOGS)], change)
    drive = drive_of(cell, seed, records)
    counted = replay(drive, with_change(drive.slam, change)).counts
    seen = max(counted["tp"] + counted["fn"], 1)
    return {
        "recall": counted["tp"] / seen,
        "wrong_per_1000": 1e3 * counted["fp"] / seen,
        "rmse_cm": 100.0 * counted["rmse_m"],
        "log_nees": math.log(max(counted["nees"], 1e-9) / 3.0),
    }


def drive_of(cell: str, seed: int, records: Records) -> Drive:
    """The recorded drive of a cell."""
    if cell in noise.SETS:
        return noise.drive_of(cell, seed, records)
    buildings, fields = EXPLORED[cell]
    number = (seed - FIRST_SEED) % len(kth_plans()) if cell == KTH else FIRST_BUILDING + seed
    return records.drive(Course(f"{buildings}:{number}", seed, {"estimator": "truth", "max_steps": 1500} | fields))


calibrated = cache(real_logs.calibrated)


def on_log(name: str, change: dict[str, Any]) -> Row:
    """The path errors on a log: a path that is nowhere known is as wrong as it is long."""
    log, calibration = calibrated(name)
    run = LOGS[name].run.model_copy(update={"scans": LOG_SCANS})
    figures = run_log(log, config_for(log, change, calibration), run, calibration=calibration).metrics()
    errors = {f"log_{key}": math.log(figures.get(key, figures["metres"])) for key in ("ate_m", "final_ate_m")}
    return {"lost_share": 1.0 - figures["localised_share"], **errors}


def roughly(records: Records, seed: int, change: dict[str, Any]) -> Row:
    """Scans of a drive against the map that the variant makes of it, at 2 m and 20 degrees."""
    drive = records.drive(loop.course(ROUGH_SETS[seed % len(ROUGH_SETS)], seed))
    drive = replace(drive, slam=with_change(drive.slam, change))
    finished, rng = finish(drive), np.random.default_rng(seed)
    looks = drawn_looks(drive, finished, loop.SCANS, rng)
    associator = make_associator(drive.slam.association)
    counted = count_scans(finished, associator, looks, loop.SIGMAS[-1], rng.normal(size=(loop.SCANS, 3)))
    return {"right": counted["right"] / counted["scans"], "wrong_pairs": float(counted["wrong"])}


def report(figures: Figures) -> str:
    """The variants that make a difference, and the names of those that change nothing."""
    flat = {f"`{name}`": flatten(cells) for name, cells in figures.items()}
    rows = [
        [name, *path.split("/"), figure]
        for name, of in flat.items()
        for path, figure in of.items()
        if figure["n"] > 1 and (figure["low"] > 0.0 or figure["high"] < 0.0)
    ]
    ends = ("value", "low", "high")
    same = [name for name, of in flat.items() if not any(figure[end] for figure in of.values() for end in ends)]
    quiet = sorted(flat.keys() - {row[0] for row in rows} - set(same))
    parts = [
        f"{len(figures)} variants.",
        table(["variant", "cell", "figure", "minus default"], rows),
        f"No difference outside of its interval ({len(quiet)}): {', '.join(quiet) or '-'}.",
        f"Same bits ({len(same)}): {', '.join(same) or '-'}.",
    ]
    return "\n\n".join(parts)
