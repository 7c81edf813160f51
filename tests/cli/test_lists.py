"""Options that take several words may be given again: the words add up. Weights of a reward stand for its preset."""

import re
from typing import Any

import pytest

from benchmarks.__main__ import parser
from mecp_env.cli import main as cli
from mecp_env.cli.base import LISTS, Line
from mecp_env.cli.options import with_reward_preset
from mecp_env.config import REWARDS

Captured = pytest.CaptureFixture[str]


def options_of_lists(words: str, capsys: Captured) -> set[str]:
    """The options of a command that take several words, by its help."""
    with pytest.raises(SystemExit):
        cli.main([*words.split(), "--help"])
    shown = capsys.readouterr().out
    return set(re.findall(r"^\W*(--[\w.-]+) .*\.\.\.\]", shown, re.MULTILINE))


@pytest.mark.slow
def test_the_lists_are_those_of_the_commands(capsys: Captured) -> None:
    found = {option for words in cli.COMMANDS for option in options_of_lists(words, capsys)}
    assert found == set(LISTS)


def test_words_of_an_option_add_up_in_their_order() -> None:
    for option in LISTS:
        line = ["here", option, "a", "-1", "--seed", "1", f"{option}=b", "2", "--out", "x", option, "c"]
        assert Line(line).gathered() == ("here", option, "a", "-1", "b", "2", "c", "--seed", "1", "--out", "x")
    others = Line(["bfs", "--seed", "1", "--seed=2", "--no-truth", "--door-width-m", "1", "2"])
    assert others.gathered() == others
    assert others.named() == ["seed", "no_truth", "door_width_m"]
    assert others.first_words("--seed") == ["1", "2"]


@pytest.mark.parametrize(
    ("words", "line", "path", "value"),
    [
        ("worlds generate", "--shapes L --seed 3 --shapes T", "spec.shapes", ("L", "T")),
        ("train", "ppo --buildings.difficulty easy --buildings.difficulty hard", "fields.buildings.difficulty", None),
        ("demo", "--config.reward.custom a 1 --config.reward.custom b 2", "config.reward.custom", {"a": 1, "b": 2}),
        ("demo", "--with a --with b", "modules", ("a", "b")),
    ],
)
def test_a_command_has_all_words(words: str, line: str, path: str, value: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(REWARDS, "others", ["a", "b"])
    monkeypatch.setattr(cli, "import_modules", lambda names: None)
    found: Any = cli.parse(words, Line(line.split()))
    for name in path.split("."):
        found = getattr(found, name)
    assert found == value if value is not None else len(found) == 2


def test_a_benchmark_has_all_words() -> None:
    for option, field in (("with", "modules"), ("sets", "sets"), ("policies", "policies")):
        given = parser().parse_args(["association", f"--{option}", "a", "b", "--jobs", "2", f"--{option}", "c"])
        assert getattr(given, field) == ["a", "b", "c"]
        assert getattr(parser().parse_args(["association"]), field) == []


@pytest.mark.parametrize(
    ("line", "preset"),
    [
        (["--env.reward.completion", "1"], "--env.reward.preset"),
        (["--config.reward.a-optimality=2"], "--config.reward.preset"),
        ([], None),
        (["--env.reward.source", "truth"], None),
    ],
)
def test_weights_of_the_reward_without_a_preset_stand_for_terms(line: list[str], preset: str | None) -> None:
    assert with_reward_preset(Line(["ppo", *line])) == ("ppo", *line, *([preset, "terms"] if preset else []))
