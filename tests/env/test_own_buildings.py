"""Buildings of a registered generator (docs/own-parts.md), and plans from a file or a folder (`FloorPlan-v0`)."""

import re
import shutil
import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import mecp_env  # noqa: F401
from mecp_env.core.errors import ConfigError, LayoutError, PlanWarning
from mecp_env.env import MecpEnv
from mecp_env.episode import buildings
from mecp_env.episode.buildings import make_source, register_buildings
from mecp_env.floorplans import folder as folders
from mecp_env.floorplans import plan_files
from mecp_env.floorplans.exporters import save_map_server
from mecp_env.world.layout import LIBRARY, load_layout
from tests.command_lines import modules_of_page

PAGE = Path(__file__).parents[2] / "docs/own-parts.md"


@pytest.fixture
def registered() -> Iterator[None]:
    """Names that a test registers are forgotten."""
    before, names = dict(buildings.SOURCES), list(buildings.NAMES.others)
    yield
    buildings.SOURCES.clear()
    buildings.SOURCES.update(before)
    buildings.NAMES.others[:] = names


@pytest.fixture
def rows(monkeypatch: pytest.MonkeyPatch, registered: None) -> types.ModuleType:
    """The module of the page."""
    made = types.ModuleType("rows")
    exec(modules_of_page()["rows"], made.__dict__)
    monkeypatch.setitem(sys.modules, "rows", made)
    return made


def test_the_code_of_the_page_runs(rows: types.ModuleType) -> None:
    use = re.search(r"```python\n(import gymnasium as gym\nimport rows\n.*?)```", PAGE.read_text(), re.DOTALL)
    assert use is not None
    env = {}
    exec(use[1], env)
    assert env["env"].unwrapped.summary()["rooms"] == 5


def test_its_buildings_are_sound_and_differ_and_batches_and_states_know_it(rows: types.ModuleType) -> None:
    source = make_source({"rows": {"rooms": 3}})
    layouts = [source.layout(number) for number in range(10)]
    assert len({layout.to_json() for layout in layouts}) == 10
    assert source.layout(4) == layouts[4]
    env = MecpEnv({"layout": {"rows": {}}})
    first, _ = env.reset(seed=3)
    state = env.get_state()
    env.step([0.3, 0.1])
    env.set_state(state)
    assert (env.observation()["pose"] == first["pose"]).all()
    venv = gym.make_vec("mecp_env/Layout-v0", 2, layout={"rows": {}}, max_steps=5)
    venv.reset(seed=0)
    venv.close()


class Broken:
    count = 2

    def layout(self, building: int) -> Any:
        return {"name": "x"} if building else "two_rooms"


@pytest.mark.parametrize(
    ("make", "fields", "said"),
    [
        (Broken, {"rooms": 3}, r"layout: mine: .*takes no arguments"),
        (Broken, 3, r"layout: \{'mine': \{\.\.\.\}\} stands alone"),
        (lambda: object(), {}, r"layout: mine: expected a method `layout` and a `count` of 1 or more, got None"),
        (type("None_", (Broken,), {"count": 0}), {}, r"a `count` of 1 or more, got 0"),
    ],
)
def test_what_is_no_source_is_refused(registered: None, make: Any, fields: Any, said: str) -> None:
    register_buildings("mine", make)
    with pytest.raises(ConfigError, match=said):
        make_source({"mine": fields})


def test_a_building_that_is_no_layout_and_a_name_that_cannot_be_registered_are_named(registered: None) -> None:
    register_buildings("mine", Broken)
    source = make_source({"mine": {}})
    assert len(source.layout(0).rooms) == 2
    with pytest.raises(LayoutError, match=r"mine: building 1: .*walls"):
        source.layout(1)
    with pytest.raises(ConfigError, match="make: 3, a class or function expected"):
        register_buildings("mine", 3)
    for name in ("generate", "plan", "walls", "two words", 3):
        with pytest.raises(ConfigError, match="name: "):
            register_buildings(name, dict)


PLAN = "mecp_env/FloorPlan-v0"
QUICK = {"laser": {"sweeps": 1}, "max_steps": 20}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copy(LIBRARY / "furnished.json", tmp_path / "a.json")
    save_map_server(load_layout("two_rooms"), tmp_path / "b", 0.05)
    (tmp_path / "readme.txt").write_text("no plan")
    (tmp_path / "empty").mkdir()
    return tmp_path


def test_a_plan_is_explored(folder: Path) -> None:
    env = gym.make(PLAN, plan=folder / "b.yaml", **QUICK)
    observation, info = env.reset(seed=0)
    assert (info["rooms"], info["doors"], info["building"]) == (2, 1, 0)
    for _ in range(5):
        observation, *_ = env.step(np.array([0.5, 0.1], np.float32))
    assert observation["landmarks"][:, -1].sum() > 3


def test_of_a_folder_each_plan_comes(folder: Path) -> None:
    env = gym.make(PLAN, plan=str(folder), **QUICK)
    rooms = [env.reset(seed=0)[1]["rooms"], *(env.reset()[1]["rooms"] for _ in range(11))]
    assert set(rooms) == {2, 4}
    assert env.reset(options={"building": 1})[1]["rooms"] == 2
    with pytest.raises(ConfigError, match="building: 2"):
        env.reset(options={"building": 2})


def test_options_reach_the_reader(folder: Path) -> None:
    env = gym.make(PLAN, plan=folder / "b.yaml", door_width_m=(0.4, 0.6), **QUICK)
    assert env.reset(seed=0)[1]["doors"] == 0
    again = gym.make(PLAN, config=env.unwrapped.config)
    assert again.unwrapped.config == env.unwrapped.config


@pytest.mark.parametrize(
    ("keywords", "error", "named"),
    [
        ({}, ConfigError, "path of a floor plan"),
        ({"plan": "nowhere.json"}, LayoutError, "nowhere"),
        ({"plan": "nowhere"}, LayoutError, "nowhere: no such file or folder"),
        ({"plan": "x.docx"}, LayoutError, "docx"),
        ({"plan": ""}, ConfigError, "plan: the path of a floor plan"),
        ({"plan": b"b.yaml"}, ConfigError, r"plan: the path of a floor plan.*\(given: b'b.yaml'\)"),
        ({"config": {"layout": {"plan": {"path": 3}}}}, ConfigError, r"plan: the path of a floor plan"),
        ({"layout": "paper"}, ConfigError, "layout"),
        ({"plan": "b.yaml", "door_width_m": (3.0, 1.0)}, ConfigError, "door_width_m"),
        ({"plan": "b.yaml", "door_width_m": 0.9}, ConfigError, r"door_width_m: two widths, the narrower first"),
        ({"plan": ".", "resolution": 0.05}, ConfigError, r"argument 'resolution'; did you mean 'resolution_m'"),
        ({"plan": "empty"}, ConfigError, "no file in it"),
    ],
)
def test_wrong_input_is_named(folder: Path, monkeypatch, keywords: dict, error: type, named: str) -> None:
    monkeypatch.chdir(folder)
    with pytest.raises(error, match=named):
        gym.make(PLAN, **keywords)


@pytest.fixture
def tree(folder: Path) -> Path:
    """Folders in folders: a layout, a map_server pair, an image with a pair beside it, one that is hidden."""
    for name in ("z", "m/n", ".hidden"):
        (folder / name).mkdir(parents=True)
    shutil.copy(LIBRARY / "paper.json", folder / "m" / "n" / "p.json")
    shutil.copy(LIBRARY / "office.json", folder / ".hidden" / "o.json")
    shutil.copy(folder / "b.pgm", folder / "z" / "alone.pgm")
    save_map_server(load_layout("two_rooms"), folder / "z" / "pair", 0.05)
    return folder


def names(plans: tuple[Path, ...], folder: Path) -> list[str]:
    return [path.relative_to(folder).as_posix() for path in plans]


def test_the_folders_in_a_folder_are_entered_in_order(tree: Path) -> None:
    assert names(plan_files(tree), tree) == ["a.json", "b.yaml", "m/n/p.json", "z/pair.yaml"]
    all_plans = ["a.json", "b.yaml", "m/n/p.json", "z/alone.pgm", "z/pair.yaml"]
    assert names(plan_files(tree, images=True), tree) == all_plans
    assert names(plan_files(tree, "map_server"), tree) == ["b.yaml", "z/pair.yaml"]
    assert names(plan_files(tree, "image"), tree) == ["z/alone.pgm"]


def test_plain_images_of_a_folder_are_plans_with_a_resolution(tree: Path) -> None:
    env = gym.make(PLAN, plan=tree, resolution_m=0.05, **QUICK)
    with pytest.warns(PlanWarning, match="grey 205"):
        rooms = [env.reset(seed=0, options={"building": building})[1]["rooms"] for building in range(5)]
    assert rooms == [4, 2, 9, 2, 2]
    again = gym.make(PLAN, config=env.unwrapped.config)
    assert again.reset(seed=3)[1]["building"] == env.reset(seed=3)[1]["building"]


def test_links_within_the_folder_are_plans_or_not_followed_and_others_are_refused(tree: Path) -> None:
    (tree / "c.json").symlink_to(tree / "a.json")
    (tree / "round").symlink_to(tree)
    assert names(plan_files(tree), tree) == ["a.json", "b.yaml", "c.json", "m/n/p.json", "z/pair.yaml"]
    for outside in (LIBRARY, LIBRARY / "paper.json"):
        (tree / "m" / "link.json").symlink_to(outside)
        with pytest.raises(LayoutError, match=r"link\.json: a link that leaves the folder"):
            plan_files(tree)
        (tree / "m" / "link.json").unlink()


def test_too_many_files_and_none_that_can_be_read_are_refused(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tree / "z" / "pair.yaml").unlink()
    with pytest.raises(ConfigError, match=r"no file in it ends in .*resolution_m"):
        plan_files(tree / "z")
    monkeypatch.setattr(folders, "MAX_FILES", 4)
    with pytest.raises(ConfigError, match="more than 4 files"):
        plan_files(tree)


def test_so_many_plans_are_kept_and_no_more(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(buildings, "KEPT_PLANS", 2)
    plans = make_source({"plan": {"path": str(tree)}})
    read = list[Path]()
    monkeypatch.setattr(buildings, "load_plan", read.append)
    for building in (0, 1, 2, 2, 1, 0):
        plans.layout(building)
    assert read == [plans.paths[building] for building in (0, 1, 2, 0)]


class Faulty:
    """Whose code fails, as a user's may."""

    count = 2

    def __init__(self, early: bool = False) -> None:
        if early:
            raise OSError("no data")

    def layout(self, building: int) -> str:
        if building == 1:
            raise KeyError("door")
        return "two_rooms"


def test_an_error_in_the_code_of_a_source_names_the_source_the_building_and_the_line(registered: None) -> None:
    register_buildings("faulty", Faulty)
    env = gym.make("mecp_env/Layout-v0", layout={"faulty": {}})
    with pytest.raises(LayoutError, match=r"faulty: building 1: KeyError: 'door' \(layout, line \d+\)"):
        env.reset(options={"building": 1})
    with pytest.raises(ConfigError, match=r"layout: faulty: OSError: no data \(__init__, line \d+\)"):
        make_source({"faulty": {"early": True}})


def test_a_source_that_is_not_registered_is_named_and_not_taken_for_a_layout(registered: None) -> None:
    register_buildings("faulty", Faulty)
    with pytest.raises(ConfigError, match=r"'fault': not registered .* \(registered: faulty\); did you mean 'faulty'"):
        make_source({"fault": {}})
