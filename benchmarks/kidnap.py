"""A robot that is not where it believes: one wrong odometry reading, and carried to another place of the map.

The default estimator maps a drive that was recorded with the true pose as the driver. `reading`: at a random step of
the second half, one odometry reading is wrong by 1 m along the path and 20 degrees, with random signs, and the drive
goes on. `carried`: after the drive, the robot is put at a random place of a second drive in the same building, which
goes on from there; its scans are not those that the map was made of. Each event starts from the same map as the others
of its drive, ends 30 scans later, and changes nothing for the next. `hard` are generated buildings of the test split,
from number 600 on. Rows that name an associator (docs/associators.md) have the same drives and events, with a map that
this associator made.

An event is noticed when `confidence` falls below 0.5 within 10 scans, or when the pose is right after every scan all
the same: that share is `harmless`. It is relocalised when the robot is localised within 10 scans with a position error
below 0.5 m and 10 degrees. `wrong_poses` counts those that were accepted after a search with a larger error.
`false_alarms` are scans before the events, 30 each, with a confidence below 0.5 and a position error below 0.5 m.
`auc` is the area under the ROC curve of `confidence` for "the error is below 0.5 m" over all these scans;
`calibration` is the mean difference of confidence and frequency over ten bins, weighted by their scans.
"""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from benchmarks.common import Figures, Options, estimate, ratio, runs_of
from benchmarks.drives import WRONG_M, Drive, calibration_error, off, roc_area
from benchmarks.plots import Panel, line_panels
from benchmarks.records import IN_MEMORY, Course, Records, on_records, place
from benchmarks.tables import columns_of, one_table, table_of
from benchmarks.variants import DEFAULT, VARIANTS, with_change
from mecp_env.core.carriers import Array
from mecp_env.core.se2 import compose, inverse
from mecp_env.slam.pipeline import SlamPipeline

SETS = {"paper": 20, "office": 20, "hard": 20}  # drives
METHODS = ("", "jcbb with descriptor")  # that of the default estimator, and a rival
FIRST_BUILDING, MAX_STEPS = 600, 10_000
EVENTS, QUICK_EVENTS = 10, 3  # events of each kind on a drive
BEFORE, AFTER, WITHIN = 30, 30, 10  # scans
READING_M, READING_RAD = 1.0, math.radians(20.0)
WRONG_RAD, DOUBTED = math.radians(10.0), 0.5
SHOWN = (0, 1, 2, 3, 4, 6, 8, 10, 15, 20, 29)  # scans after an event, in the figure
KINDS = ("reading", "carried")
SHARES = ("noticed", "harmless", "relocalised", "right_at_end")
SECOND_DRIVE = 1000  # added to the seed


def run(options: Options) -> Figures:
    """Results of every layout and kind of event."""
    task = partial(disturb, count=QUICK_EVENTS if options.quick else EVENTS)
    runs = runs_of(options, SETS)
    drives = [(f"{layout} {method}".strip(), seed) for layout, seed in runs for method in METHODS]
    return {where: summarise(found) for where, found in on_records(task, Figures, drives, options).items()}


def disturb(task: tuple[str, int], records: Records = IN_MEMORY, count: int = EVENTS) -> Figures:
    """What happened in the events on the drive of one layout, associator and seed; per kind a list over events."""
    where, seed = task
    layout, _, method = where.partition(" ")
    fields, building = {"estimator": "truth", "max_steps": MAX_STEPS}, place(layout, FIRST_BUILDING + seed)
    first, second = (records.drive(Course(building, start, fields)) for start in (seed, seed + SECOND_DRIVE))
    change = VARIANTS[method or DEFAULT].change
    rng, pipeline = np.random.default_rng(seed), SlamPipeline(with_change(first.slam, change))
    T_map_world, size = inverse(first.T_world_robot[0]), len(first.scans)
    wrong = rng.choice(np.arange(size // 2, size - AFTER), count, replace=False).tolist()
    readings, trace = list[Figures](), list[list[float]]()
    for step, (output, T_world_robot) in enumerate(first.outputs(pipeline), 1):
        trace.append([output.confidence, off(output.belief.T_map_robot, compose(T_map_world, T_world_robot))[0]])
        if step in wrong:
            readings.append(outcome(misread(first.part(step, AFTER), rng), pipeline, T_map_world))
    starts = rng.choice(np.arange(1, len(second.scans) - AFTER), count, replace=False).tolist()
    carried = [outcome(second.part(start, AFTER), pipeline, T_map_world) for start in starts]
    before = [row for step in sorted(wrong) for row in trace[max(step - BEFORE, 0) : step]]
    return {"reading": readings, "carried": carried, "before": before}


def misread(event: Drive, rng: np.random.Generator) -> Drive:
    """A part of a drive whose first odometry is wrong."""
    first, along, turn = event.odometry[0], *rng.choice((-1.0, 1.0), 2)
    assert first is not None
    increments = first.increments.copy()
    increments[0] += along * READING_M, turn * READING_RAD
    return replace(event, odometry=[replace(first, increments=increments), *event.odometry[1:]])


def outcome(event: Drive, mapped: SlamPipeline, T_map_world: Array) -> Figures:
    """What happened in the scans of an event, on a copy of the map; `trace`: confidence and error of each."""
    scans = []
    for output, T_world_robot in event.outputs(copy.deepcopy(mapped)):
        error_m, error_rad = off(output.belief.T_map_robot, compose(T_map_world, T_world_robot))
        right = error_m < WRONG_M and error_rad < WRONG_RAD
        scans.append((output.confidence, error_m, right, output.localised))
    confidence, error_m, right, localised = np.array(scans, float).T
    found = (right > 0) & (localised > 0)
    resumed = (localised > 0) & (np.append(1.0, localised[:-1]) == 0)  # a pose was accepted after a search
    return {
        "noticed": bool((confidence[:WITHIN] < DOUBTED).any() or right.all()),
        "harmless": bool(right.all()),
        "relocalised": bool(found[:WITHIN].any()),
        "accepted": bool((resumed & (right == 0)).any()),
        "right_at_end": bool(found[-1]),
        "trace": np.stack([confidence, error_m], axis=1).tolist(),
    }


def summarise(drives: list[Figures]) -> Figures:
    """Results of all drives of a layout, with 95 % intervals over drives."""
    traces, before = [scans_of(drive) for drive in drives], [np.array(drive["before"]) for drive in drives]
    alarms = [((scans[:, 0] < DOUBTED) & (scans[:, 1] < WRONG_M)).sum() for scans in before]
    scores = {"auc": roc_area, "calibration": calibration_error}
    confidence: Figures = {name: estimate([score(*of.T) for of in traces]) for name, score in scores.items()}
    confidence |= {f"{name}_of_all": score(*np.concatenate(traces).T) for name, score in scores.items()}
    confidence["false_alarms"] = ratio(alarms, list(map(len, before)))
    return {kind: of_events([drive[kind] for drive in drives]) for kind in KINDS} | {"confidence": confidence}


def of_events(drives: list[list[Figures]]) -> Figures:
    """Results of the events of a kind on each drive."""
    rows = [
        {name: sum(event[name] for event in events) for name in (*SHARES, "accepted")}
        | {f"right_{k}": sum(event["trace"][k][1] < WRONG_M for event in events) for k in SHOWN}
        | {"events": len(events)}
        for events in drives
    ]
    of = columns_of(rows)
    return {
        **{name: ratio(of[name], of["events"]) for name in SHARES},
        "right_after": [ratio(of[f"right_{k}"], of["events"]) for k in SHOWN],
        "wrong_poses": int(of["accepted"].sum()),
        "events": int(of["events"].sum()),
    }


def scans_of(drive: Figures) -> Array:
    """(n,2) confidence and position error of all scans of a drive's events and before them."""
    traces = [event["trace"] for kind in KINDS for event in drive[kind]]
    return np.concatenate([np.array(rows) for rows in (drive["before"], *traces)])


def figure(figures: Figures) -> Figure:
    """Share of events after which the position is right again, by scans."""
    ticks = [str(k) for k in SHOWN]
    lines = {kind: {name: cells[kind]["right_after"] for name, cells in figures.items()} for kind in KINDS}
    panels = {f"{kind}: scans after the event": Panel(ticks, of) for kind, of in lines.items()}
    return line_panels(panels, "share with an error below 0.5 m")


def report(figures: Figures) -> str:
    """One table of events and one of confidence."""
    events = {f"{layout}, {kind}": cells[kind] for layout, cells in figures.items() for kind in KINDS}
    confidence = {layout: cells["confidence"] for layout, cells in figures.items()}
    columns = (*SHARES, "wrong_poses", "events")
    return f"{table_of('layout, event', columns, events)}\n\n{one_table(confidence)}"
