"""Shards of every experiment, run apart and in another order, give the figures of a single run to the bit."""

import importlib
import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks import __main__ as command
from benchmarks.common import Options, ShardDone
from benchmarks.tables import report_of
from mecp_env.core.work_units import Shard

MEASURED = {"association_time", "map_size", "scale", "soak"}  # their figures are times and memory
TIMES = {"associate_ms", "ms", "us", "time_us", "timed", "steps_per_s"}
Patches = dict[str, Any]  # "module.name" -> value
PARTIAL = {"claims", "filters"}  # whose page takes more than two units
WITHOUT_ROOMS = {"association": {"use_rooms": False}}

TINY: dict[str, tuple[dict[str, Any], Patches]] = {  # options and patches, for two units or a few
    "ablation": (
        {"sets": ("odometry_x1:1",)},
        {"noise.LAYOUT": "two_rooms", "ablation.changes": lambda: {"default": {}, "off": WITHOUT_ROOMS}},
    ),
    "association": ({"sets": ("two_rooms:2",)}, {}),
    "claims": (
        {"quick": True},
        {
            "claims.DRIVES": {"two_rooms": 2},
            "claims.IDEAL": {"two_rooms": 2},
            "claims.LOOPS": {"two_rooms": 2},
            "claims.POSES": 12,
            "claims.shipped_layouts": lambda: ("two_rooms",),
            "claims.SITES": (5, 8),
            "loop.SCANS": 2,
            "rough_pose.FIRST_SCAN": 2,
        },
    ),
    "clutter": ({}, {"clutter.SETS": {"two_rooms": 1}, "clutter.CELLS": ((1.0, 0), (0.9, 20))}),
    "consistency": ({}, {"consistency.LAYOUT": "two_rooms", "consistency.SETS": {"per_metre": 1, "skid_steer": 1}}),
    "explorers": ({}, {"explorers.SEEDS": {"two_rooms": 2}, "explorers.MAX_STEPS": 30}),
    "features": ({"quick": True}, {"features.shipped_layouts": lambda: ("two_rooms", "twins")}),
    "filters": ({"quick": True}, {"filters.READINGS": "per_step_1_m"}),
    "kidnap": (
        {"quick": True},
        {"kidnap.SETS": {"two_rooms": 2}, "kidnap.AFTER": 3, "kidnap.BEFORE": 3, "kidnap.SHOWN": (0, 2)},
    ),
    "loop": ({"quick": True}, {"loop.SETS": {"two_rooms": 2}, "rough_pose.FIRST_SCAN": 2}),
    "mutated": ({"quick": True}, {"mutated.QUICK": 1}),
    "paper_mode": ({"sets": ("two_rooms:2",)}, {"paper_mode.SETS": {"two_rooms": 2}}),
    "noise": ({}, {"noise.LAYOUT": "two_rooms", "noise.SETS": {"odometry_x1": 1, "view_180_deg": 1}}),
    "real": ({"sets": ("view_180_deg:2",)}, {"noise.LAYOUT": "two_rooms"}),
    "restore": ({"quick": True}, {"restore.QUICK": 2}),
    "returns": ({"sets": ("First:2",), "policies": ("nearest",)}, {}),
    "sensors": ({}, {"sensors.LAYOUTS": ("two_rooms",), "sensors.SETS": {"paper": 1, "lms200": 1}}),
    "structures": (
        {"sets": ("two_rooms:2",)},
        {
            "structures.SETS": {"two_rooms": 2},
            "structures.ROUGH": {"two_rooms": 2},
            "loop.SCANS": 2,
            "rough_pose.FIRST_SCAN": 2,
        },
    ),
    "uncertainty": ({"sets": ("base:2",), "policies": ("nearest",)}, {"uncertainty.TASKS": 20}),
    "worlds": ({"sets": ("easy:2",)}, {"worlds.MAX_STEPS": 30}),
}


def test_every_experiment_in_units_is_compared_here() -> None:
    assert set(TINY) == set(command.IN_UNITS) - MEASURED


@pytest.fixture
def experiment(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> tuple[Any, Any]:
    options, patches = TINY[request.param]
    if request.param == "consistency":
        pytest.importorskip("gtsam", reason="extra `lab`")
    module = importlib.import_module(f"benchmarks.{request.param}")
    for name, value in patches.items():
        where, _, attribute = name.partition(".")
        owner = importlib.import_module(f"benchmarks.{where}")
        if attribute == "READINGS":
            value = {value: owner.READINGS[value]}
        if attribute == "TASKS":
            value = {owner.TASK: {**owner.TASKS[owner.TASK], "max_steps": value}}
        monkeypatch.setattr(owner, attribute, value)
    monkeypatch.setattr("benchmarks.worlds.KEPT", tmp_path / "worlds")
    return module, options


@pytest.mark.slow
@pytest.mark.parametrize("experiment", TINY, indirect=True)
def test_shards_give_the_figures_of_a_single_run(experiment: tuple[Any, dict[str, Any]], tmp_path: Path) -> None:
    module, options = experiment
    whole = figures(module, tmp_path / "whole", **options)
    for number in (2, 1):
        with pytest.raises(ShardDone):
            figures(module, tmp_path / "shards", shard=Shard(number, 2), **options)
    assert figures(module, tmp_path / "shards", **options) == whole


def figures(module: Any, folder: Path, **options: Any) -> str:
    """The figures of a run as text, without what the clock says; they have a page, and a picture where there is one."""
    run = module.run(Options(folder=folder, records=folder / "records", **options))
    if module.__name__.rpartition(".")[2] not in PARTIAL:
        assert getattr(module, "report", report_of)(run).count("|") >= 10
        assert not hasattr(module, "figure") or module.figure(run).axes
    return json.dumps(untimed(run), sort_keys=True)


def untimed(figures: Any) -> Any:
    """The figures without times."""
    if not isinstance(figures, dict):
        return figures
    return {name: untimed(inner) for name, inner in figures.items() if name not in TIMES}
