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

from benchmarks import noise, worlds
from benchmarks.common import Figures, Gate, Options, chosen, share, shared_data
from benchmarks.drives import replay
from benchmarks.plan_scores import score_plan
from benchmarks.real_logs import LOGS, map_log
from benchmarks.real_logs import summarise as summarise_log
from benchmarks.real_maps import MapData, caption, short, small_multiples
from benchmarks.records import IN_MEMORY, KTH, Records, on_records
from benchmarks.tables import columns_of, means, of_visits, ratios, sections, table_of, turned
from benchmarks.variants import with_change
from benchmarks.worlds import Visit, explored
from mecp_env.floorplans import load_plan
from mecp_env.world.outline import build_outline

PLANS, EXPLORED, VIEW = "plans", "explored", "view_180_deg"
URG = {f"urg04lx_{layout}": layout for layout in ("paper", "medium")}
VIEW_DEG = 180.0
STEPS_PER_M2 = 10.0
MAPS = Path("runs/real")  # of each log, and of the first start in each plan
SETS = {PLANS: 1, EXPLORED: 3, **{name: log.runs for name, log in LOGS.items()}, VIEW: 20, **dict.fromkeys(URG, 10)}
QUICK = {PLANS: 1, EXPLORED: 1, "fr079": 1, "csail_raw": 1, VIEW: 1, "urg04lx_paper": 1}
QUICK_PLANS, QUICK_SCANS = ("0a1b29dba355df2ab02630133187bfab", "50052752", "skirk"), 300

GATES = (
    Gate("plans/all/found", "share", 0.01),
    Gate("explored/kth/seen", "share", 0.06),
    Gate("explored/kth/precision", "share", 0.003),
    Gate("fr079/relations_m", "error", 1.1),
    Gate("fr079/final_relations_m", "error", 1.1),
    Gate("fr079/polygon_share", "share", 0.02),
    Gate(f"{VIEW}/precision", "share", 0.003),
    *(Gate(f"{name}/complete", "share", 0.1) for name in URG),
)
SHARES = ("seen", "complete", "lost", "early")
TOTALS = (
    *("coverage", "precision", "pose_rmse_m", "nees", "rooms_found", "rooms_false", "doors_found"),
    *("doors_false_per_10_true", "duplicates", "contacts_per_100_m", "periods_per_m2", "metres"),
)
Task = tuple[str, str, int]  # set, plan or number of scans or layout, start or seed


def run(options: Options) -> Figures:
    """Results of every set that there are data for."""
    counts = chosen(options.sets, SETS) or (QUICK if options.quick else SETS)
    skipped = {name: f"no {at}" for name in counts if (at := missing(name))}
    sys.stderr.writelines(f"{name}: skipped, {reason}\n" for name, reason in skipped.items())
    tasks = [task for name in counts if name not in skipped for task in tasks_of(name, counts[name], options.quick)]
    results: dict[str, dict[str, list[Figures]]] = {}
    for (name, what), of_one in on_records(measure, dict[str, Any], tasks, options).items():
        results.setdefault(name, {})[what] = of_one
    figures = {
        name: SUMMARIES[name](parts if name in (PLANS, EXPLORED) else next(iter(parts.values())))
        for name, parts in results.items()
    }
    return figures | ({"skipped": skipped} if skipped else {})


def missing(name: str) -> str | None:
    """What a set would need that is not there."""
    if name in LOGS:
        there = (folder := shared_data("logs")) is not None and (folder / f"{name}.npz").is_file()
        return None if there else f"shared/data/logs/{name}.npz"
    return "shared/data/plans" if name in (PLANS, EXPLORED) and not plans() else None


def tasks_of(name: str, count: int, quick: bool) -> list[Task]:
    """The units of work of a set."""
    if name in LOGS:
        return [(name, str(QUICK_SCANS if quick else "all"), seed) for seed in range(count)]
    if name in (PLANS, EXPLORED):
        known = [
            plan for plan in plans() if (not quick or plan in QUICK_PLANS) and (name == EXPLORED or is_labelled(plan))
        ]
        return [(name, plan, start) for plan in known for start in range(count)]
    return [(name, URG.get(name, noise.LAYOUT), seed) for seed in range(count)]


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
        return score_plan(plans()[what])._asdict()
    if name == EXPLORED:
        return explore(what, seed)
    if name in LOGS:
        return run_on_log(name, seed, None if what == "all" else int(what))
    return look_ahead(seed, records) if name == VIEW else explore_with_urg(name, seed)


def explore(plan: str, start: int) -> Figures:
    """One exploration of a plan."""
    layout = load_plan(plans()[plan])
    most = int(STEPS_PER_M2 * build_outline(layout).free_area.area)
    visit, env = explored(layout, start, most)
    if start == 0:
        MapData.of_env(env).save(MAPS / f"{plan}.npz")
    return figures_of(visit) | {"step_limit": most}


def explore_with_urg(name: str, seed: int) -> Figures:
    """One exploration with that laser."""
    layout = URG[name] if name == "urg04lx_paper" else worlds.building(URG[name], seed)
    visit, _ = explored(layout, seed, worlds.MAX_STEPS, laser={"preset": "urg04lx"})
    return figures_of(visit)


def figures_of(visit: Visit) -> Figures:
    """The figures of an exploration."""
    final = {name: float(value) for name, value in visit.final.items()}
    complete, early = visit.outcome == "complete", visit.terminated and not visit.seen
    return final | {"seen": visit.seen, "complete": complete, "early": early}


def run_on_log(name: str, seed: int, scans: int | None) -> Figures:
    """One run on a log."""
    folder = shared_data("logs")
    assert folder is not None
    metrics, drawn = map_log(folder, name, seed, scans)
    if seed == 0:
        drawn.save(MAPS / f"{name}.npz")
    return metrics


def look_ahead(seed: int, records: Records = IN_MEMORY) -> Figures:
    """A drive on `paper` whose scans are cut to the field of view, for an estimator that knows it."""
    drive = noise.drive_of(VIEW, seed, records)
    return replay(drive, with_change(drive.slam, {"sensor": {"field_of_view_deg": VIEW_DEG}})).counts


def summarise_plans(results: Mapping[str, list[Figures]]) -> Figures:
    """Rooms of each plan, and of all together with the interval over plans."""
    each = {plan: scores[0] for plan, scores in results.items()}
    of = columns_of(list(each.values()))
    both = ratios(of, found="found/labelled", false="false/imported")
    return {"all": both | {name: int(of[name].sum()) for name in ("labelled", "imported")}, **each}


def summarise_explored(results: Mapping[str, list[Figures]]) -> Figures:
    """Explorations of all labelled plans together, and of each plan."""
    labelled = [visit for plan, visits in results.items() if is_labelled(plan) for visit in visits]
    each = {plan: summarise_visits(visits) for plan, visits in results.items()}
    return ({KTH: summarise_visits(labelled)} if labelled else {}) | each


def summarise_visits(visits: list[Figures]) -> Figures:
    """Figures of explorations, each with its 95 % interval."""
    figures = {name: share(visit[name] for visit in visits) for name in SHARES} | of_visits(visits, TOTALS)
    worst = max(visit["pose_rmse_m"] for visit in visits)
    area = float(np.mean([visit["free_area_m2"] for visit in visits]))
    return figures | {"pose_rmse_worst_m": worst, "free_area_m2": area}


def summarise_view(drives: list[Figures]) -> Figures:
    """As in `noise`, with the share of scans that have a polygon."""
    return noise.summarise(drives) | means(columns_of(drives), "polygon_share")


SUMMARIES: dict[str, Any] = {  # of the results by plan, or of those of a set without parts
    PLANS: summarise_plans,
    EXPLORED: summarise_explored,
    **dict.fromkeys(LOGS, summarise_log),
    VIEW: summarise_view,
    **dict.fromkeys(URG, summarise_visits),
}


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
    return small_multiples(
        {caption(figures, name): MapData.load(MAPS / f"{name}.npz") for name in names if name != KTH}
    )
