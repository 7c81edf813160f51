"""The site describes every environment id and every public name (`sphinx-build -W` checks its links)."""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import mecp_env
from mecp_env.episode.tasks import TASKS
from tests.test_documents import resolve

ROOT = Path(__file__).parent.parent
REFERENCE = "".join(path.read_text() for path in (ROOT / "docs/api").glob("*.md"))
API = re.findall(r"automodule:: ([\w.]+)", REFERENCE)
LISTED = {*API, *re.findall(r"auto(?:class|function):: ([\w.]+)", REFERENCE)}
PAGES = [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "docs/notebooks").glob("*.md")]
IMPORT = re.compile(r"^(?:>>> )?from (mecp_env[\w.]*) import (\([^)]*\)|.+)$", re.MULTILINE)


@pytest.fixture
def pages(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    return importlib.import_module("environment_pages")


@pytest.mark.parametrize("name", mecp_env.ENVIRONMENTS)
def test_every_id_has_a_page_with_spaces_rewards_arguments_and_versions(pages: Any, name: str) -> None:
    env, text = pages.make(name), pages.page(name)
    for key in pages.make(name, observation="dict").observation_space:
        assert f"\n### {key}\n" in text
    for title in ("Action Space", "Rewards", "Episode End", "Arguments", "Version History"):
        assert re.search(rf"\n## {title}\n+[^\n#]", text), title
    assert str(env.action_space) in text
    assert re.search(r"\| `reward_contact_share` \| -0.1 \| per share of the step limit", text)
    assert "/tests/" not in text
    assert str(ROOT) not in text


def test_a_page_names_what_an_environment_sets_itself(pages: Any) -> None:
    range_m = TASKS["ActiveHalls-v0"]["laser"]["max_range_m"]
    assert f"| `laser.max_range_m` | `{range_m}` |" in pages.page("mecp_env/ActiveHalls-v0")
    assert "| `layout` | `'paper'` |" in pages.page("mecp_env/PaperMap-v0")


@pytest.mark.parametrize("name", TASKS)
def test_the_film_of_a_task_shows_drives_and_its_page_leads_to_the_tasks(pages: Any, name: str) -> None:
    """The nearest row was that of waiting, so that the robot stood still."""
    assert pages.explore(pages.make(f"mecp_env/{name}")) > 5.0
    assert "(../tasks.md)" in pages.page(f"mecp_env/{name}")


def test_fields_carry_their_comments(pages: Any) -> None:
    text = pages.configuration_page()
    assert "| `laser.sweeps` | `4` |" in text
    assert "| `odometry.distance_sigma_m` | `0.1` | per sqrt(m), per step, or per metre |" in text
    assert "| `reward.coverage` | `1.0` | per mean coverage over the step limit |" in text


def public(module: str) -> Iterator[tuple[str, Any]]:
    """The classes and functions of a module, and their methods and properties."""
    found = importlib.import_module(module)
    named = getattr(found, "__all__", None) or [
        n for n, o in vars(found).items() if of_module(o, module) and n[0] != "_"
    ]
    for name in named:
        item = getattr(found, name)
        if inspect.isclass(item) or inspect.isroutine(item):
            yield f"{module}.{name}", item
        if inspect.isclass(item) and item.__module__.startswith("mecp_env"):
            own = [(key, value) for key, value in vars(item).items() if key[0] != "_"]
            methods = [
                key for key, value in own if inspect.isroutine(value) or isinstance(value, property | classmethod)
            ]
            yield from ((f"{module}.{name}.{key}", getattr(item, key)) for key in methods)


def of_module(item: object, module: str) -> bool:
    """True for a class or function that a module defines."""
    return getattr(item, "__module__", "") == module and (inspect.isclass(item) or inspect.isroutine(item))


@pytest.mark.parametrize("module", API)
def test_every_public_name_is_documented(module: str) -> None:
    if module == "mecp_env.learning.sb3_batch":
        pytest.importorskip("stable_baselines3", reason="needs the extra rl")
    if module == "mecp_env.learning.train":
        pytest.importorskip("torch", reason="needs the extra rl")
    assert importlib.import_module(module).__doc__
    assert [name for name, item in public(module) if not inspect.getdoc(item)] == []


def names_in(text: str) -> set[str]:
    """The dotted names below `mecp_env` of a page, and those that its code imports."""
    dotted = re.findall(r"\bmecp_env(?:\.\w+)+", text)
    imported = {
        f"{module}.{name.split()[0]}"
        for module, names in IMPORT.findall(text)
        for name in names.partition("#")[0].strip("() ,\n").split(",")
    }
    return {*dotted, *imported}


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_names_in_documents_exist_and_are_in_the_reference(page: Path) -> None:
    for name in sorted(names_in(page.read_text())):
        assert resolve(name) is not None
        parts = name.split(".")
        above = {".".join(parts[:count]) for count in range(2, len(parts) + 1)}
        below = any(listed.startswith(f"{name}.") for listed in LISTED)
        assert above & LISTED or below or ".".join(parts[:-1]) == "mecp_env", f"{name} is not in docs/api"
