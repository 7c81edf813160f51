"""Buildings of a registered generator (docs/own-parts.md)."""

from __future__ import annotations

import re
import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest

from mecp_env.core.errors import ConfigError, LayoutError
from mecp_env.env import MecpEnv
from mecp_env.episode import buildings
from mecp_env.episode.buildings import make_source, register_buildings
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
