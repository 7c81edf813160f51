"""The command lines that documents, results, help texts and docstrings show to a user."""

import ast
import json
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

from mecp_env.cli.main import COMMANDS, load

ROOT = Path(__file__).parent.parent
PAGES = ("README.md", "CONTRIBUTING.md")  # the change log has commands of earlier versions
CODE = ("mecp_env", "agents", "benchmarks", "docs")
STARTS = re.compile(r"(?:\.venv/bin/)?(mecp-env|python -m (?:mecp_env|benchmarks)|python agents/\w+\.py)(?![\w.])")
FENCED = re.compile(r"^```([^\n]*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
LANGUAGES = ("", "sh", "bash", "console")
OPTIONAL = re.compile(r"\[-[^]]*\]")
BRACES = re.compile(r"(\S*)\{(\d+)\.\.(\d+)\}(\S*)")
PLACEHOLDERS = {"NAME": "speed", "COMMAND": "demo", "GIT_REF": "HEAD", "HOST:PORT": "localhost:1", "I/N": "1/2"}
MENTION = 3  # words: in a sentence, so many name a command and no line that a user types
SHELL = {"|", "||", "&&", ";", ">", "<", "&"}


def lines_of_documents() -> Iterator[tuple[str, str]]:
    """(where, line) of the fenced blocks and the quoted lines of every page."""
    folders = [path for folder in ("docs", "benchmarks/results") for path in (ROOT / folder).rglob("*.md")]
    for path in sorted([*(ROOT / name for name in PAGES), *folders]):
        text, where = path.read_text(), str(path.relative_to(ROOT))
        shell = [block for language, block in FENCED.findall(text) if language in LANGUAGES]
        yield from ((where, line) for block in shell for line in _joined(block))
        for quoted in re.findall(r"(?<!`)`([^`]+)`(?!`)", FENCED.sub("", text)):
            yield from _quoted(where, quoted)


def lines_of_results() -> Iterator[tuple[str, str]]:
    """(where, line) of the command that each file of results names."""
    for path in sorted(ROOT.glob("benchmarks/results/**/*.json")):
        content = json.loads(path.read_text())
        if isinstance(content, dict) and isinstance(content.get("command"), str):
            yield str(path.relative_to(ROOT)), content["command"]


def lines_of_help() -> Iterator[tuple[str, str]]:
    """(where, line) of the examples that `--help` shows."""
    for words in COMMANDS:
        yield from ((f"mecp-env {words} --help", example) for example in load(words).help()[1])


def lines_of_docstrings() -> Iterator[tuple[str, str]]:
    """(where, line) of the indented blocks and the quoted lines of the docstring of every module, class, function."""
    for path in sorted(file for folder in CODE for file in (ROOT / folder).rglob("*.py")):
        where = str(path.relative_to(ROOT))
        for text in _docstrings(ast.parse(path.read_text())):
            indented = (line.strip() for line in _joined(text) if line.startswith("    "))
            yield from ((where, line) for line in indented if STARTS.match(line))
            for quoted in re.findall(r"`([^`]+)`", text):
                yield from _quoted(where, quoted)


def command_of(line: str) -> list[str] | None:
    """The words of the command in a line of a shell, with placeholders filled; None for a line without one."""
    found = STARTS.search(line)
    if not found:
        return None
    quote = line[: found.start()].rstrip()[-1:]
    rest = line[found.start(1) :]
    rest = rest.split(quote)[0] if quote in ("'", '"') else rest
    rest = re.sub(r"\$\{?\w+\}?", "1", rest).replace(" ...", "")
    words = shlex.split(BRACES.sub(_expanded, rest), comments=True)
    ends = [at for at, word in enumerate(words) if word in SHELL or word.endswith(";")]
    cut = words[: ends[0] + 1] if ends and words[ends[0]] not in SHELL else words[: ends[0]] if ends else words
    return [PLACEHOLDERS.get(word, word).rstrip(";") for word in cut]


def _expanded(found: re.Match[str]) -> str:
    before, first, last, after = found.groups()
    return " ".join(f"{before}{number}{after}" for number in range(int(first), int(last) + 1))


def _joined(text: str) -> list[str]:
    """The lines of a text, with continued ones as one."""
    return re.sub(r"\\\n\s*", "", text).splitlines()


def _quoted(where: str, quoted: str) -> Iterator[tuple[str, str]]:
    """A quoted line that is more than the name of a command or of its options, as `mecp-env evaluate --suite` is."""
    line = " ".join(OPTIONAL.sub("", quoted).split())
    values = [word for word in line.split() if not word.startswith("--")]
    if STARTS.match(line) and len(values) > MENTION:
        yield where, line


def _docstrings(tree: ast.Module) -> Iterator[str]:
    kinds = ast.Module | ast.ClassDef | ast.FunctionDef
    for node in ast.walk(tree):
        if isinstance(node, kinds) and (text := ast.get_docstring(node)):
            yield text


def modules_of_page() -> dict[str, str]:
    """The code of each module of docs/own-parts.md by its name."""
    page = (ROOT / "docs/own-parts.md").read_text()
    return {name: text for text, name in re.findall(r'```python\n("""(\w+)\.py""".*?)```', page, re.DOTALL)}


def written_modules(folder: Path) -> list[str]:
    """The names of the modules of docs/own-parts.md, which are written to a folder."""
    for name, text in modules_of_page().items():
        (folder / f"{name}.py").write_text(text)
    return list(modules_of_page())
