"""The documentation matches the code: links, commands, names of functions and tests, versions."""

import importlib
import re
import tomllib
from pathlib import Path

import pytest

import mecp_env
from mecp_env.cli.main import COMMANDS
from mecp_env.slam.config import SlamConfig

Captured = pytest.CaptureFixture[str]
ROOT = Path(__file__).parent.parent
GENERATED = ROOT / "docs/environments"  # by the build of the site, which checks their links and may run beside
DOCUMENTS = [path for path in (*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")) if path.parent != GENERATED]
PAPER_SECTIONS = (ROOT / "docs/paper.md").read_text().split("\n### ")[1:]


def resolve(name: str) -> object:
    """The object of a dotted name in mecp_env."""
    parts = name.removeprefix("mecp_env.").split(".")
    for cut in range(len(parts), -1, -1):
        try:
            found: object = importlib.import_module(".".join(["mecp_env", *parts[:cut]]))
        except ModuleNotFoundError:
            continue
        for attribute in parts[cut:]:
            found = getattr(found, attribute)
        return found
    raise ModuleNotFoundError(name)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_and_paths_lead_somewhere(document: Path) -> None:
    text = document.read_text()
    local = [link for link in re.findall(r"\]\(([^)#\s]+)\)", text) if not link.startswith("http")]
    assert not [target for target in local if not (document.parent / target).exists()]
    paths = re.findall(r"`((?:tests|mecp_env|slam|benchmarks|docs)/[\w./-]*(?:\.\w+|/))`", text)
    found = [(ROOT / "mecp_env" if path.startswith("slam") else ROOT) / path for path in paths]
    assert not [path for path in found if path.stem != "NAME" and not path.exists()]


def test_decisions_have_their_parts_and_a_row_in_the_index() -> None:
    index = (ROOT / "docs/decisions/README.md").read_text()
    records = sorted((ROOT / "docs/decisions").glob("0*.md"))
    assert [path.name[:4] for path in records] == [f"{number:04}" for number in range(1, len(records) + 1)]
    for path in records:
        text = path.read_text()
        title = text.partition("\n")[0].removeprefix("# ")
        assert f"| [{title}]({path.name}) |" in index, path.name
        assert re.findall(r"^\*\*(\w+)\.\*\*", text, re.MULTILINE) == ["Context", "Decision", "Evidence", "Consequence"]


def test_the_architecture_has_a_row_for_every_folder() -> None:
    text = (ROOT / "docs/architecture.md").read_text()
    for path in (ROOT / "mecp_env", ROOT / "mecp_env/slam"):
        folders = [child.name for child in path.iterdir() if (child / "__init__.py").exists()]
        assert not [name for name in folders if not re.search(rf"^\| .*`{name}/`", text, re.MULTILINE)]


def test_the_site_has_every_page_once() -> None:
    lines = (ROOT / "docs/index.md").read_text().splitlines()
    pages = [path for path in ROOT.glob("docs/**/*.md") if path.parent.name not in ("decisions", "environments", "api")]
    names = [str(path.relative_to(ROOT / "docs").with_suffix("")) for path in pages if path.name != "index.md"]
    assert {name: lines.count(name) for name in names} == dict.fromkeys(names, 1)
    commands = (ROOT / "docs/commands.md").read_text()
    assert [words for words in COMMANDS if f"`{words}`" not in commands] == []


def test_the_python_of_the_readme_runs(capsys: Captured) -> None:
    code = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert code is not None
    exec(code[1], {})
    assert "3)" in capsys.readouterr().out


def test_the_estimator_runs_alone_as_documented(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    _, record, run, localise, configure = re.findall(  # tests/slam/test_own_stream.py runs the first one
        r"```python\n(.*?)```", (ROOT / "docs/estimator.md").read_text(), re.DOTALL
    )
    monkeypatch.chdir(tmp_path)
    exec(record, {})
    exec(run + localise + configure, {})
    out = capsys.readouterr().out
    assert "door      between rooms (0, 1) width 0.9" in out
    assert "moved [0.73 0.94 2.48]" in out
    assert Path("map.yaml").exists()


@pytest.mark.parametrize("section", PAPER_SECTIONS, ids=lambda text: text.partition("\n")[0])
def test_functions_tests_and_switches_that_a_statement_of_the_paper_names_exist(section: str) -> None:
    said, code, tests = re.split(r"\n*Code: |\s+Tests?: ", section.partition("\n## ")[0])
    functions = re.findall(r"`((?:slam|lab|world|planning|render)\.[\w.]+)`", code)
    named = re.findall(r"`(tests/[\w./]+)(?:::(\w+))?`", tests)
    assert functions
    assert named
    for name in functions:
        assert resolve(name) is not None
    for path, test in named:
        assert f"def {test}" in (ROOT / path).read_text(), f"{path}::{test}"
    for part, field in re.findall(r"`(\w+)\.(\w+)(?:=\S+)?`", said):
        assert field in type(getattr(SlamConfig(), part)).model_fields, f"{part}.{field}"


def test_every_switch_of_the_papers_mode_is_on_its_page_and_one_version_everywhere() -> None:
    """A section that `SlamConfig.paper()` changes is named in `docs/paper.md`, by itself or by one of its fields."""
    text, ours, paper = (ROOT / "docs/paper.md").read_text(), SlamConfig(), SlamConfig.paper()
    changed = {part for part in SlamConfig.model_fields if getattr(ours, part) != getattr(paper, part)}
    assert len(changed) > 5
    assert [part for part in sorted(changed) if not re.search(rf"`{part}[.`]", text)] == []
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    cited = re.findall(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert [project["version"]] == [mecp_env.__version__] == cited


def test_no_file_names_a_machine() -> None:
    folders = (".ci", "agents", "benchmarks", "docs", "mecp_env", "tests")
    files = [*ROOT.glob("*.*"), *(path for folder in folders for path in (ROOT / folder).rglob("*"))]
    written = {".py", ".md", ".json", ".toml", ".cff", ""}
    text = [path for path in files if path.is_file() and path.suffix in written]
    assert len(text) > 50
    named = re.compile(rb"/(?:wor[k]|roo[t]|hom[e])/\w")
    assert not [path for path in text if named.search(path.read_bytes())]
