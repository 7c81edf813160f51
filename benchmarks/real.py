"""Real buildings and logs: imported floor plans, explorations of them, recorded logs, and lasers that exist.

Plans and logs are those of `shared/data` beside the repository; without them, their sets are skipped and the page says
so. `plans`: rooms of at least 2 m2 that are found (IoU above 0.5), of the rooms in the labels of the KTH floors, and
imported rooms that match no label. `explored`: breadth first, three starts in each plan, at most 10 control steps per
m2 of the floor that a robot can reach. An exploration is seen when it ends by itself with 95 % of that floor seen,
ended early when it ends by itself with less, complete when it is seen, not lost, and has every room and door; lost and
the other figures are those of the benchmark `worlds`. `fr079`: odometry is made of the reference path with the paper's
noise, five seeds; `intel_raw`, `csail_raw`: raw odometry, calibrated as `mecp-env slam` does without an option, which
reads no reference path. Relations are the mean errors of relative poses measured by hand (Kuemmerle et al. 2009), with
poses interpolated to their times; `at_scans` are those that need no interpolation; times are those of one core. `final`
are the figures of the path that is smoothed over all scans after the run, and `final_s` the seconds of the smoothing.
`karto` is OpenKarto with its own settings on the same scans (benchmarks/karto.py; extra `lab`), without a calibration.
`view_180_deg`: drives on `paper` with the true pose as the driver, cut to 180 degrees as in `noise`, and an estimator
that knows it. `urg04lx`: explorations with that laser.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from benchmarks import noise, worlds
from benchmarks.common import Figures, Options, chosen, ratio, shared_data
from benchmarks.drives import replay
from benchmarks.plan_scores import score_plan
from benchmarks.plots import pictures_figure
from benchmarks.real_logs import LOGS, MAPS, map_log
from benchmarks.real_logs import summarise as summarise_log
from benchmarks.records import IN_MEMORY, KTH, Records, on_records
from benchmarks.tables import columns_of, of_visits, sections, summary, table_of, turned
from benchmarks.variants import with_change
from benchmarks.worlds import explored
from mecp_env.floorplans import load_plan
from mecp_env.render.screen import map_picture
from mecp_env.world.outline import build_outline

PLANS, EXPLORED, VIEW = "plans", "explored", "view_180_deg"
URG = {f"urg04lx_{layout}": layout for layout in ("paper", "medium")}
VIEW_DEG, STEPS_PER_M2 = 180.0, 10.0
SETS = {PLANS: 1, EXPLORED: 3, **{name: log.runs for name, log in LOGS.items()}, VIEW: 20, **dict.fromkeys(URG, 10)}
QUICK = {PLANS: 1, EXPLORED: 1, "fr079": 1, "csail_raw": 1, VIEW: 1, "urg04lx_paper": 1}
QUICK_PLANS, QUICK_SCANS = ("0a1b29dba355df2ab02630133187bfab", "50052752", "skirk"), 300

TOTALS = (
    *("seen", "complete", "lost", "early", "coverage", "precision", "pose_rmse_m", "nees", "rooms_found"),
    *("rooms_false", "doors_found", "doors_false_per_10_true", "duplicates", "contacts_per_100_m", "periods_per_m2"),
    "metres",
)
CAPTIONS = {  # of a log, above its map
    "final_relations_m": "final relations",
    "final_ate_m": "final trajectory error",
    "dead_reckoning_ate_m": "dead reckoning",
}
Task = tuple[str, str, int]  # set, plan or number of scans or layout, start or seed


def run(options: Options) -> Figures:
    """Results of every set that there are data for."""
    counts = chosen(options, SETS, QUICK)
    skipped = {name: f"no {at}" for name in counts if (at := missing(name))}
    sys.stderr.writelines(f"{name}: skipped, {reason}\n" for name, reason in skipped.items())
    tasks = [task for name in counts if name not in skipped for task in tasks_of(name, counts[name], options.quick)]
    results: dict[str, dict[str, list[Figures]]] = {}
    for (name, what), of_one in on_records(measure, dict[str, Any], tasks, options).items():
        results.setdefault(name, {})[what] = of_one
    figures = {name: summarise(name, parts) for name, parts in results.items()}
    return figures | ({"skipped": skipped} if skipped else {})


def missing(name: str) -> str | None:
    """What a set would need that is not there."""
    if name in LOGS:
        there = (folder := shared_data("logs")) is not None and (folder / f"{name}.npz").is_file()
        return None if there else f"shared/data/logs/{name}.npz"
    return "shared/data/plans" if name in (PLANS, EXPLORED) and not plans() else None


def tasks_of(name: str, count: int, quick: bool) -> list[Task]:
    """The units of work of a set."""
    names = [str(QUICK_SCANS if quick else "all")] if name in LOGS else [URG.get(name, noise.LAYOUT)]
    if name in (PLANS, EXPLORED):
        known = [plan for plan in plans() if not quick or plan in QUICK_PLANS]
        names = [plan for plan in known if name == EXPLORED or is_labelled(plan)]
    return [(name, what, number) for what in names for number in range(count)]


def plans() -> dict[str, Path]:
    """The real floor plans by their names: those of a building, not the drawn dungeons."""
    return {path.stem: path for path in worlds.plans_at_hand() if path.suffix in (".json", ".yaml")}


def is_labelled(plan: str) -> bool:
    """True when there is an image with the true room of each pixel."""
    return plans()[plan].with_suffix(".rooms.png").is_file()


def measure(task: Task, records: Records = IN_MEMORY) -> Figures:
    """The figures of one unit of work."""
    name, what, seed = task
    if name == PLANS:
        return score_plan(plans()[what])
    if name in LOGS:
        return map_log(name, seed, None if what == "all" else int(what))
    if name == VIEW:
        drive = noise.drive_of(VIEW, seed, records)
        return replay(drive, with_change(drive.slam, {"sensor": {"field_of_view_deg": VIEW_DEG}})).counts
    return explore(name, what, seed)


def explore(name: str, what: str, seed: int) -> Figures:
    """One exploration of a plan, or of a building with the laser `urg04lx`."""
    if name == EXPLORED:
        layout: Any = load_plan(plans()[what])
        most, fields = int(STEPS_PER_M2 * build_outline(layout).free_area.area), {}
    else:
        layout = what if name == "urg04lx_paper" else worlds.building(what, seed)
        most, fields = worlds.MAX_STEPS, {"laser": {"preset": "urg04lx"}}
    visit, env = explored(layout, seed, most, **fields)
    if name == EXPLORED and seed == 0:
        MAPS.mkdir(parents=True, exist_ok=True)
        Image.fromarray(map_picture(env.get_wrapper_attr("view")())).save(MAPS / f"{what}.png")
    return visit


def summarise(name: str, parts: Mapping[str, list[Figures]]) -> Figures:
    """Figures of a set, from the results of each of its plans, or of the only part that it has."""
    if name == PLANS:
        each = {plan: scores[0] for plan, scores in parts.items()}
        of = columns_of(list(each.values()))
        both = {"found": ratio(of["found"], of["labelled"]), "false": ratio(of["false"], of["imported"])}
        return {"all": both | {name: int(of[name].sum()) for name in ("labelled", "imported")}, **each}
    if name == EXPLORED:
        labelled = [visit for plan, visits in parts.items() if is_labelled(plan) for visit in visits]
        together = {KTH: labelled} if labelled else {}
        return {plan: summarise_visits(visits) for plan, visits in (together | dict(parts)).items()}
    (runs,) = parts.values()
    if name == VIEW:
        return summary(runs, (*noise.COLUMNS, "polygon_share"))
    return summarise_log(runs) if name in LOGS else summarise_visits(runs)


def summarise_visits(visits: list[Figures]) -> Figures:
    """Figures of explorations, each with its 95 % interval."""
    worst = max(visit["pose_rmse_m"] for visit in visits)
    area = float(np.mean([visit["free_area_m2"] for visit in visits]))
    return of_visits(visits, TOTALS) | {"pose_rmse_worst_m": worst, "free_area_m2": area}


def report(figures: Figures) -> str:
    """A table for the plans, the explorations, the logs and the lasers."""
    skipped = [f"{name}, {why}" for name, why in figures.get("skipped", {}).items()]
    sets = {"Logs": LOGS, "URG-04LX, breadth first": URG, "View of 180 degrees on paper": (VIEW,)}
    tables = {title: {name: figures[name] for name in names if name in figures} for title, names in sets.items()}
    tables = {"Explorations": figures.get(EXPLORED, {}), **tables}
    parts = {title: turned(of, [short(name) for name in of]) for title, of in tables.items() if of}
    if PLANS in figures:
        rooms = table_of("plan", ("labelled", "found", "imported", "false"), figures[PLANS])
        parts = {"Rooms of the imported KTH floors": rooms, **parts}
    return "\n\n".join([*(f"Skipped: {text}." for text in skipped), sections(parts)])


def figure(figures: Figures) -> Figure:
    """The map of each log, and of the first start in each plan."""
    names = [name for name in (*LOGS, *figures.get(EXPLORED, {})) if name in figures or name not in LOGS]
    return pictures_figure({caption(figures, name): MAPS / f"{name}.png" for name in names if name != KTH})


def short(name: str) -> str:
    """A name that fits in a column."""
    return name if len(name) <= 20 else f"{name[:8]}..."


def caption(figures: Figures, name: str) -> str:
    """What is said above a map."""
    of = figures.get(name) or figures[EXPLORED][name]
    mean = {key: figure["value"] if isinstance(figure, dict) else figure for key, figure in of.items()}
    if name not in figures:
        return f"{short(name)}:\n{of['free_area_m2']:,.0f} m2, pose RMSE {100.0 * mean['pose_rmse_m']:.1f} cm"
    said = ",\n".join(f"{text} {mean[key]:.2f} m" for key, text in CAPTIONS.items() if key in of)
    return f"{name}, {mean['log_share']:.0%} of the log:\n{said}"
