"""The site describes every environment id and every public name (`sphinx-build -W` checks its links)."""

import importlib
import inspect
import re
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

import mecp_env
from tests.test_documents import resolve

ROOT = Path(__file__).parent.parent
REFERENCE = "".join(path.read_text() for path in (ROOT / "docs/api").glob("*.md"))
API = re.findall(r":: ([\w.]+)", REFERENCE)
MOST = 85  # public names; may only become fewer
PAGES = [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "docs/notebooks").glob("*.md")]
IMPORT = re.compile(r"^(?:>>> )?from (mecp_env[\w.]*) import (\([^)]*\)|.+)$", re.MULTILINE)


LEARNS = find_spec("stable_baselines3") is not None  # the extra rl


@pytest.fixture(autouse=True, scope="module")
def learning() -> None:
    """Stable-Baselines3 imports its parts in its own order only."""
    if LEARNS:
        importlib.import_module("stable_baselines3")


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


def test_the_film_of_a_task_shows_drives_and_its_page_leads_to_the_tasks(pages: Any) -> None:
    """The nearest row was that of waiting, so that the robot stood still."""
    assert pages.explore(pages.make("mecp_env/ActiveHalls-v0")) > 5.0
    assert "(../tasks.md)" in pages.page("mecp_env/ActiveHalls-v0")


def described(name: str, item: Any) -> Iterator[tuple[str, Any]]:
    """A public name; of a class also its methods and properties."""
    if inspect.isclass(item) or inspect.isroutine(item):
        yield name, item
    if inspect.isclass(item):
        own = [(key, value) for key, value in vars(item).items() if key[0] != "_"]
        methods = [key for key, value in own if inspect.isroutine(value) or isinstance(value, property | classmethod)]
        yield from ((f"{name}.{key}", getattr(item, key)) for key in methods)


def test_public_names_are_few_listed_once_and_documented() -> None:
    assert len(API) == len(set(API)) <= MOST
    for name in API:
        if LEARNS or ".learning." not in name:
            item = resolve(name)
            assert item is not None
            assert [part for part, found in described(name, item) if not inspect.getdoc(found)] == []


def names_in(text: str) -> set[str]:
    """The dotted names below `mecp_env` of a page, and those that its code imports."""
    dotted = re.findall(r"\bmecp_env(?:\.\w+)+", text)
    imported = {
        f"{module}.{name.split()[0]}"
        for module, names in IMPORT.findall(text)
        for name in names.partition("#")[0].strip("() ,\n").split(",")
    }
    return {*dotted, *imported}


def test_names_in_documents_exist_and_are_in_the_reference() -> None:
    known = [public for public in API if LEARNS or ".learning." not in public]
    for name in sorted({name for page in PAGES for name in names_in(page.read_text())}):
        if ".learning." in name and not LEARNS:
            continue
        assert resolve(name) is not None
        listed = any(f"{public}.".startswith(f"{name}.") or f"{name}.".startswith(f"{public}.") for public in API)
        same = any(resolve(public) is resolve(name) for public in known)  # by another path
        assert listed or same or name.rpartition(".")[0] == "mecp_env", f"{name} is not in docs/api"
