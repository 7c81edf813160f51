"""Buildings of a registered generator (docs/own-parts.md), and plans from a file or a folder (`FloorPlan-v0`)."""

import re
import shutil
import sys
import types
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest

import mecp_env  # noqa: F401
from mecp_env.core.errors import ConfigError, LayoutError
from mecp_env.episode import buildings
from mecp_env.episode.buildings import make_source, register_buildings
from mecp_env.floorplans import plan_files
from mecp_env.floorplans.exporters import save_map_server
from mecp_env.world.layout import LIBRARY, load_layout
from tests.command_lines import modules_of_page

PAGE = Path(__file__).parents[2] / "docs/own-parts.md"


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Names that a test registers are forgotten."""
    monkeypatch.setattr(buildings, "SOURCES", dict(buildings.SOURCES))
    monkeypatch.setattr(buildings.NAMES, "others", list(buildings.NAMES.others))


def test_the_code_of_the_page_runs_and_batches_and_states_know_it(monkeypatch, registered) -> None:
    made, found = types.ModuleType("rows"), dict[str, Any]()
    exec(modules_of_page()["rows"], made.__dict__)
    monkeypatch.setitem(sys.modules, "rows", made)
    use = re.search(r"```python\n(import gymnasium as gym\nimport rows\n.*?)```", PAGE.read_text(), re.DOTALL)
    assert use is not None
    exec(use[1], found)
    env = found["env"].unwrapped
    assert env.summary()["rooms"] == 5
    state, first = env.get_state(), env.observation()["pose"]
    env.step([0.3, 0.1])
    env.set_state(state)
    assert (env.observation()["pose"] == first).all()
    venv = gym.make_vec("mecp_env/Layout-v0", 2, layout={"rows": {}}, max_steps=5)
    venv.reset(seed=0)
    venv.close()


class Broken:
    """Whose code is wrong, as a user's may be."""

    count = 3

    def layout(self, building: int) -> Any:
        return {0: "two_rooms", 1: {"name": "x"}}[building]


NO_SOURCE: list[tuple[Any, Any, str]] = [
    (Broken, {"rooms": 3}, r"layout: mine: .*takes no arguments"),
    (Broken, 3, r"layout: \{'mine': \{\.\.\.\}\} stands alone"),
    (object, {}, r"layout: mine: expected a method `layout` and a `count` of 1 or more, got None"),
    (lambda: 1 / 0, {}, r"layout: mine: ZeroDivisionError: .* \(<lambda>, line \d+\)"),
]


def test_what_is_no_source_or_building_and_names_that_are_not_registered_or_cannot_be_are_named(registered) -> None:
    for make, fields, said in NO_SOURCE:
        register_buildings("mine", make)
        with pytest.raises(ConfigError, match=said):
            make_source({"mine": fields})
    register_buildings("mine", Broken)
    source = make_source({"mine": {}})
    assert len(source.layout(0).rooms) == 2
    with pytest.raises(LayoutError, match=r"mine: building 1: .*walls"):
        source.layout(1)
    with pytest.raises(LayoutError, match=r"mine: building 2: KeyError: 2 \(layout, line \d+\)"):
        source.layout(2)
    with pytest.raises(ConfigError, match=r"'mime': not registered .* \(registered: mine\); did you mean 'mine'"):
        make_source({"mime": {}})
    for name, made in (("mine", 3), ("generate", dict), ("two words", dict)):
        with pytest.raises(ConfigError, match=r"name: |make: 3, a class or function expected"):
            register_buildings(name, made)


PLAN = "mecp_env/FloorPlan-v0"
QUICK = {"laser": {"sweeps": 1}, "max_steps": 20}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Folders in folders: layouts, map_server pairs, one of them with an image beside it, a folder that is hidden."""
    for name in ("z", "m/n", ".hidden", "empty"):
        (tmp_path / name).mkdir(parents=True)
    for name, place in (("furnished", "a.json"), ("two_rooms", "m/n/p.json"), ("office", ".hidden/o.json")):
        shutil.copy(LIBRARY / f"{name}.json", tmp_path / place)
    save_map_server(load_layout("two_rooms"), tmp_path / "b", 0.05)
    save_map_server(load_layout("two_rooms"), tmp_path / "z" / "pair", 0.05)
    shutil.copy(tmp_path / "b.pgm", tmp_path / "z" / "alone.pgm")
    (tmp_path / "readme.txt").write_text("no plan")
    return tmp_path


def test_of_a_folder_each_plan_comes(folder: Path) -> None:
    env = gym.make(PLAN, plan=str(folder), **QUICK)
    rooms = [env.reset(seed=0)[1]["rooms"], *(env.reset()[1]["rooms"] for _ in range(11))]
    assert set(rooms) == {2, 4}
    assert env.reset(options={"building": 1})[1]["rooms"] == 2
    with pytest.raises(ConfigError, match="building: 4"):
        env.reset(options={"building": 4})
    one = gym.make(PLAN, plan=folder / "b.yaml", door_width_m=(0.4, 0.6), **QUICK)
    assert one.reset(seed=0)[1]["doors"] == 0
    assert gym.make(PLAN, config=one.unwrapped.config).unwrapped.config == one.unwrapped.config


WRONG_PLAN: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({}, ConfigError, "path of a floor plan"),
    ({"plan": "nowhere.json"}, LayoutError, "nowhere"),
    ({"plan": b"b.yaml"}, ConfigError, r"plan: the path of a floor plan.*\(given: b'b.yaml'\)"),
    ({"layout": "paper"}, ConfigError, "layout"),
    ({"plan": "b.yaml", "door_width_m": 0.9}, ConfigError, r"door_width_m: two widths, the narrower first"),
    ({"plan": ".", "resolution": 0.05}, ConfigError, r"argument 'resolution'; did you mean 'resolution_m'"),
    ({"plan": "empty"}, ConfigError, "no file in it"),
]


def test_wrong_input_is_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    for keywords, error, named in WRONG_PLAN:
        with pytest.raises(error, match=named):
            gym.make(PLAN, **keywords)


def test_folders_in_a_folder_are_entered_in_order_and_no_link_leads_round_or_out_of_it(folder: Path) -> None:
    def names(*kind: Any, **images: bool) -> list[str]:
        return [path.relative_to(folder).as_posix() for path in plan_files(folder, *kind, **images)]

    assert names() == ["a.json", "b.yaml", "m/n/p.json", "z/pair.yaml"]
    assert names(images=True) == ["a.json", "b.yaml", "m/n/p.json", "z/alone.pgm", "z/pair.yaml"]
    assert names("map_server") == ["b.yaml", "z/pair.yaml"]
    assert names("image") == ["z/alone.pgm"]
    (folder / "c.json").symlink_to(folder / "a.json")
    (folder / "round").symlink_to(folder)
    assert names() == ["a.json", "b.yaml", "c.json", "m/n/p.json", "z/pair.yaml"]
    for outside in (LIBRARY, LIBRARY / "paper.json"):
        (folder / "m" / "link.json").symlink_to(outside)
        with pytest.raises(LayoutError, match=r"link\.json: a link that leaves the folder"):
            names()
        (folder / "m" / "link.json").unlink()
