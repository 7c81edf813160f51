"""Every command line that is shown to a user parses."""

import importlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import tyro

from benchmarks import __main__ as benchmarks
from mecp_env.cli import main as cli
from mecp_env.core.errors import ConfigError
from mecp_env.episode.potentials import register_reward
from tests import command_lines
from tests.command_lines import command_of, written_modules

SOURCES = {  # and how many lines there are at least
    command_lines.lines_of_documents: 80,
    command_lines.lines_of_results: 25,
    command_lines.lines_of_help: 40,
    command_lines.lines_of_docstrings: 12,
}
_parsed: set[tuple[str, ...]] = set()


@pytest.fixture
def parts_of_pages(own_parts: Path) -> None:
    """The modules that lines name after --with, in the working directory."""
    written_modules(own_parts)
    (own_parts / "my_rewards.py").write_text("")
    register_reward("landmarks_seen", lambda inputs: 0.0)


def parse(words: list[str]) -> None:
    """Parse a line with the parser of its program. Raises `ConfigError`, or ends the process."""
    if words[0] == "mecp-env" or words[2:3] == ["mecp_env"]:
        cli.parse(*cli.split(words[1:] if words[0] == "mecp-env" else words[3:]))
    elif words[2:3] == ["benchmarks"]:
        given = benchmarks.parser().parse_args(words[3:])
        benchmarks.options_of(given, importlib.import_module(f"benchmarks.{given.name}"))
    else:
        agent = words[1].removesuffix(".py").replace("/", ".")
        tyro.cli(pytest.importorskip(agent, exc_type=ImportError).Args, args=words[2:])


def failure(where: str, line: str) -> str | None:
    """What is wrong with a line; None where it parses."""
    words = command_of(line)
    if words is None or tuple(words) in _parsed:
        return None
    try:
        parse(words)
    except SystemExit as end:
        if end.code:
            return f"{where}: {line}"
    except (ConfigError, pytest.skip.Exception) as error:
        if isinstance(error, ConfigError):
            return f"{where}: {line}: {error}"
    _parsed.add(tuple(words))
    return None


@pytest.mark.slow
@pytest.mark.usefixtures("parts_of_pages")
@pytest.mark.parametrize("source", SOURCES, ids=lambda source: source.__name__)
def test_every_command_line_parses(
    source: Callable[[], Iterator[tuple[str, str]]], capsys: pytest.CaptureFixture[str]
) -> None:
    lines = [(where, line) for where, line in source() if command_of(line)]
    assert len(lines) >= SOURCES[source]
    failures = [failure(where, line) for where, line in lines]
    assert not [text for text in failures if text], capsys.readouterr().err[-3000:]
