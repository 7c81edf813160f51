"""`FloorPlan-v0`: a plan from a file, or one of a folder drawn at every reset."""

from __future__ import annotations

import shutil
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import mecp_env  # noqa: F401
from mecp_env.errors import ConfigError, LayoutError
from mecp_env.world.exporters import save_map_server
from mecp_env.world.layout import LIBRARY, load_layout

PLAN = "mecp_env/FloorPlan-v0"
QUICK = {"laser": {"sweeps": 1}, "max_periods": 20}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copy(LIBRARY / "furnished.json", tmp_path / "a.json")
    save_map_server(load_layout("two_rooms"), tmp_path / "b", 0.05)
    (tmp_path / "readme.txt").write_text("no plan")
    return tmp_path


def test_a_plan_is_explored(folder: Path) -> None:
    env = gymnasium.make(PLAN, plan=folder / "b.yaml", **QUICK)
    observation, info = env.reset(seed=0)
    assert (info["rooms"], info["doors"], info["building"]) == (2, 1, 0)
    for _ in range(5):
        observation, *_ = env.step(np.array([0.5, 0.1], np.float32))
    assert observation["landmarks"][:, -1].sum() > 3


def test_of_a_folder_each_plan_comes(folder: Path) -> None:
    env = gymnasium.make(PLAN, plan=str(folder), **QUICK)
    rooms = [env.reset(seed=0)[1]["rooms"], *(env.reset()[1]["rooms"] for _ in range(11))]
    assert set(rooms) == {2, 4}
    assert env.reset(options={"building": 1})[1]["rooms"] == 2
    with pytest.raises(ConfigError, match="building: 2"):
        env.reset(options={"building": 2})


def test_options_reach_the_reader(folder: Path) -> None:
    env = gymnasium.make(PLAN, plan=folder / "b.yaml", door_width_m=(0.4, 0.6), **QUICK)
    assert env.reset(seed=0)[1]["doors"] == 0
    again = gymnasium.make(PLAN, config=env.unwrapped.config)
    assert again.unwrapped.config == env.unwrapped.config


@pytest.mark.parametrize(
    ("keywords", "error", "named"),
    [
        ({}, ConfigError, "path of a floor plan"),
        ({"plan": "nowhere.json"}, LayoutError, "nowhere"),
        ({"plan": "x.docx"}, LayoutError, "docx"),
        ({"layout": "paper"}, ConfigError, "layout"),
        ({"plan": "b.yaml", "door_width_m": (3.0, 1.0)}, ConfigError, "door_width_m"),
    ],
)
def test_wrong_input_is_named(folder: Path, monkeypatch, keywords: dict, error: type, named: str) -> None:
    monkeypatch.chdir(folder)
    with pytest.raises(error, match=named):
        gymnasium.make(PLAN, **keywords)


def test_an_empty_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no file in it"):
        gymnasium.make(PLAN, plan=tmp_path)
