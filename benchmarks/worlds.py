"""Worlds: the breadth-first explorer in generated buildings of the test split, and in real floor plans where present.

Every preset is explored empty, with pedestrians (half as many as rooms, at most 8), and with clutter (as many boxes to
push, and every door closed with probability 0.15).

An episode is lost when the pose is more than 1 m or 10 degrees off for 20 control steps in a row or at the end, or has
diverged; seen when it terminates with 95 % of the free area seen; complete when it is seen, every room and door was
found, and it is not lost; else stuck. `map_rmse_m` is the error of the landmarks in the map frame, `landmarks_false`
counts those of no true corner. Each building is started from a place given by its number, each plan three times. Doors
of plans are 0.55 to 1.9 m wide. Each episode that is not complete is kept in `runs/worlds/`: the layout, a picture, and
the command that shows the episode again, with version and commit.
"""

from __future__ import annotations

import json
import shlex
import time
from pathlib import Path
from typing import Any

from PIL import Image

import mecp_env
from benchmarks.common import Figures, Options, chosen, grouped, in_parallel, shared_data
from benchmarks.drives import exploration
from benchmarks.records import Course
from benchmarks.tables import of_visits, sections, turned
from mecp_env.core.provenance import commit
from mecp_env.floorplans import load_plan
from mecp_env.policies.setting import words_of
from mecp_env.registration import make
from mecp_env.render.screen import map_picture
from mecp_env.world.schema import Layout
from mecp_env.wrappers import GoalActions

PEOPLE = {"easy": 2, "medium": 4, "hard": 7, "huge": 8}  # of a preset; also the number of boxes with clutter
PLANS = "plans"  # the setting of the real floor plans
SETTINGS: dict[str, tuple[str, str, dict[str, Any]]] = {PLANS: (PLANS, "plans", {})}  # preset, title, configuration
for _preset, _n in PEOPLE.items():
    _boxes = {"clutter": {"movable_boxes": _n, "closed_doors": 0.15}}
    SETTINGS[_preset] = _preset, "bare", {}
    SETTINGS[f"{_preset}_people"] = _preset, f"{_n} people", {"crowd": {"people": _n}}
    SETTINGS[f"{_preset}_clutter"] = _preset, f"{_n} boxes, 15% of doors closed", _boxes
BUILDINGS = dict.fromkeys((name for name in SETTINGS if name != PLANS), 100)
BUILDINGS |= {"huge": 30, "huge_people": 10, "huge_clutter": 10}
SETS = (*BUILDINGS, PLANS)
QUICK = {"easy": 3, "easy_clutter": 2, "medium": 2, "medium_people": 2, "medium_clutter": 2}
PLAN_STARTS = 3
MOST = 1000  # buildings of the test split
PIXEL_M = 0.05  # of plans that are plain images
MAX_STEPS = 10_000
COMPLETE_COVERAGE = 0.95
TOTALS = (
    *("seen", "complete", "stuck", "lost", "coverage", "rooms_left", "room_recall", "room_precision", "door_recall"),
    *("door_precision", "precision", "recall", "map_rmse_m", "landmarks_false", "duplicates", "landmarks_on_movers"),
    *("pose_rmse_m", "nees", "metres", "periods", "contacts_per_100_m", "grid_iou", "landmarks"),
)
KEPT = Path("runs/worlds")


def found_all(final: dict[str, float]) -> bool:
    """True when every room and every door was found."""
    return final["rooms_found"] == final["rooms"] and final["doors_found"] == final["doors"]


def run(options: Options) -> Figures:
    """Results of each setting."""
    there_are = BUILDINGS | {PLANS: PLAN_STARTS * len(plans_at_hand())}
    counts = chosen(options, there_are, QUICK, MOST)
    buildings = [(setting, index) for setting, count in counts.items() for index in range(count)]
    visits = grouped(buildings, in_parallel(visit, dict[str, float], buildings, options))
    return {setting: summarise(of_setting) for setting, of_setting in visits.items()}


def plans_at_hand() -> list[Path]:
    """The real floor plans in `shared/data/plans` beside the repository, none elsewhere; images only without a yaml."""
    folder = shared_data("plans")
    files = sorted(folder.rglob("*.*")) if folder is not None else []
    named = {file.with_suffix(".png") for file in files if file.suffix == ".yaml"}
    return [file for file in files if file.suffix in (".json", ".yaml", ".png") and file not in named]


def building(setting: str, index: int) -> Layout:
    """The building of a task: of the preset's test split, or a plan, each of which comes `PLAN_STARTS` times."""
    if setting != PLANS:
        return Course(f"{SETTINGS[setting][0]}:{index}", index).building()
    path = plans_at_hand()[index // PLAN_STARTS]
    return load_plan(path, resolution_m=PIXEL_M if path.suffix == ".png" else None)


def visit(task: tuple[str, int]) -> dict[str, float]:
    """The figures of the exploration of one building, from a start given by its number."""
    setting, index = task
    layout = building(setting, index)
    found, env = explored(layout, index, MAX_STEPS, **SETTINGS[setting][2])
    if not found["complete"]:
        keep(layout, task, found, env)
    return found


def explored(layout: str | Layout, seed: int, max_steps: int, **keywords: Any) -> tuple[dict[str, float], GoalActions]:
    """The figures of a breadth-first exploration from a start given by the seed, and the environment at its end."""
    env = make(layout=layout, actions="goal", max_steps=max_steps, start="random", **keywords)
    assert isinstance(env, GoalActions)
    begun = time.thread_time()
    *_, (_, _, terminated, _, info) = exploration(env, seed)
    speed = info["period"] / (time.thread_time() - begun)
    return ended(env.get_wrapper_attr("summary")(), terminated) | {"steps_per_s": speed}, env


def ended(final: dict[str, float], terminated: bool) -> dict[str, float]:
    """The figures of the end of an exploration, and how it ended."""
    seen, lost = terminated and final["coverage"] >= COMPLETE_COVERAGE, bool(final["lost"])
    complete = seen and found_all(final) and not lost
    ends = {"lost": lost, "complete": complete, "stuck": not (lost or complete)}
    return final | ends | {"seen": seen, "early": terminated and not seen}


def keep(layout: Layout, task: tuple[str, int], found: dict[str, float], env: GoalActions) -> None:
    """Write what is needed to repeat an episode."""
    setting, seed = task
    folder = KEPT / f"{layout.name}_{setting}_{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "layout.json").write_text(layout.to_json())
    Image.fromarray(map_picture(env.get_wrapper_attr("view")())).save(folder / "map.png")
    again = f"mecp-env demo --layout {shlex.quote(str(folder / 'layout.json'))} --seed {seed} --config.start random"
    again += f"{flags(setting)} --config.max-steps {MAX_STEPS}"
    code = {"version": mecp_env.__version__, "commit": commit()}
    record: dict[str, Any] = {"again": again, **code, "seed": seed, **found}
    (folder / "record.json").write_text(json.dumps(record, indent=2) + "\n")


def flags(setting: str) -> str:
    """The options of the demo that a setting adds."""
    return "".join(f" --config.{field.replace('_', '-')}" for field in words_of(SETTINGS[setting][2]))


def summarise(visits: list[dict[str, float]]) -> Figures:
    """Results of one preset, each with its 95 % interval."""
    return {
        **of_visits(visits, (*TOTALS, "steps_per_s")),
        "not_complete": [index for index, visit in enumerate(visits) if not visit["complete"]],
    }


def report(figures: Figures) -> str:
    """One table per preset with one column per setting; the plans last."""
    presets: dict[str, dict[str, Figures]] = {}
    for name, values in figures.items():
        presets.setdefault(SETTINGS[name][0], {})[name] = values
    titles = {name: f"{SETTINGS[name][1]} ({of['complete']['n']})" for name, of in figures.items()}
    return sections({preset: turned(of, [titles[name] for name in of]) for preset, of in presets.items()})
