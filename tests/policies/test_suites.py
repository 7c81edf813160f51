"""Frozen benchmarks: one file per result, refused where it cannot be compared; `mecp-env submit` and `leaderboard`."""

import contextlib
import io
import json
import shutil
from pathlib import Path
from typing import Any, ClassVar

import pytest

from mecp_env.cli import main as cli
from mecp_env.core.errors import ConfigError
from mecp_env.core.provenance import checksum
from mecp_env.policies import suites
from mecp_env.policies.explorers import Nearest
from mecp_env.policies.rollout import Setting
from mecp_env.policies.suites import (
    METRICS,
    SUITES,
    Suite,
    check_name,
    definition_hash,
    find_suite,
    leaderboard,
    read_submission,
    reference_rows,
    safe_name,
)

Captured = pytest.CaptureFixture[str]
SMALL = (Setting("easy", "validation", "slam", 40), Setting("", "validation", "slam", 40, "ActiveCheapRobot-v0"))
FIGURES = {metric: {"value": 0.5, "low": 0.4, "high": 0.6} for metric in METRICS}


def add_toy(patch: pytest.MonkeyPatch, settings: tuple[Setting, ...] = SMALL, episodes: int = 2) -> str:
    """A suite of two settings with two short episodes each, or of others."""
    patch.setitem(SUITES, "toy-v1", Suite(settings, episodes, ""))
    definition_hash.cache_clear()
    patch.setitem(SUITES, "toy-v1", Suite(settings, episodes, definition_hash("toy-v1")))
    return "toy-v1"


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> str:
    """Such a suite in this test."""
    return add_toy(monkeypatch)


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The file of a result of two policies, and what was printed."""
    out = tmp_path_factory.mktemp("suite")
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()) as printed:
        toy = add_toy(patch)
        assert cli.main(["evaluate", "nearest", "returning", "--suite", toy, "--no-truth", "--out", str(out)]) == 0
    return out / f"{toy}.json", printed.getvalue()


@pytest.fixture
def result(toy: str, played: tuple[Path, str], tmp_path: Path) -> Path:
    """A copy of that file."""
    return Path(shutil.copy(played[0], tmp_path))


@pytest.mark.parametrize("name", SUITES)
def test_a_published_suite_is_what_it_was(name: str) -> None:
    """A change of buildings, robots, starts, limits or metrics makes a new suite: `name-v2`."""
    assert definition_hash(name) == SUITES[name].frozen
    assert find_suite(name) is SUITES[name]


def test_one_file_has_every_episode_of_every_setting(result: Path, played: tuple[Path, str]) -> None:
    content = read_submission(result)
    rows = [(row["task"], row["policy"], len(row["episodes"])) for row in content["results"]]
    assert rows == [(task, name, 2) for task in ("easy", "ActiveCheapRobot-v0") for name in ("nearest", "returning")]
    assert set(content["results"][0]["episodes"][0]) == {"building", *suites.METRICS}
    assert "| returning |" in played[1]


def renamed(content: dict[str, Any], value: float, suffix: str = "+") -> dict[str, Any]:
    """A result with other names and figures."""
    other = json.loads(json.dumps(content))
    for row in other["results"]:
        row["policy"] += suffix
        row["figures"] |= {name: {"value": value, "low": 0.0, "high": 1.0} for name in suites.METRICS}
    return other


def test_the_leaderboard_merges_files_and_puts_the_best_first(result: Path) -> None:
    content = read_submission(result)
    better, never, namesake = (renamed(content, value, suffix) for value, suffix in ((0.9, "+"), (0.0, "-"), (0.9, "")))
    lines = leaderboard({"mine.json": content, "better.json": better}).split("\n")
    assert lines[0] == "| | easy | ActiveCheapRobot-v0 |"
    assert lines[2].endswith("| 0.900 [0.000, 1.000] | 0.900 [0.000, 1.000] |")
    assert len(lines) == 6
    least_lost = names_in(leaderboard({"often.json": better, "never.json": never}, "lost"))
    assert least_lost == [f"| {name}{suffix}" for suffix in "-+" for name in ("nearest", "returning")]
    told_apart = names_in(leaderboard({"a.json": content, "b.json": namesake, "again.json": content}))
    both = [f"| {name}, {file}" for name in ("nearest", "returning") for file in ("a.json", "b.json")]
    assert sorted(told_apart) == both


def names_in(table: str) -> list[str]:
    return [line.split(" |")[0] for line in table.split("\n")[2:]]


def signed(content: dict[str, Any]) -> dict[str, Any]:
    """A content with the checksum that belongs to it."""
    rest = {name: value for name, value in content.items() if name != "checksum"}
    return rest | {"checksum": checksum(json.dumps(rest, sort_keys=True).encode())}


def test_what_cannot_be_compared_is_refused(result: Path, capsys: Captured) -> None:
    content = json.loads(result.read_text())
    for change, message in (
        ({"hash": "0123"}, "suite toy-v1 with the hash 0123, here"),
        ({"version": 7}, "version 7, this mecp_env reads mecp_env/suite version 1"),
        ({"suite": ["toy-v9"]}, "suite ['toy-v9'], this mecp_env has"),
        ({"results": []}, f"its checksum is {content['checksum']}, that of its content "),
        (signed(content | {"results": [{"task": "easy"}]}), "results: "),
        (signed(content | {"results": [content["results"][0] | {"figures": {}}]}), "nearest in easy has no correct"),
    ):
        result.write_text(json.dumps(content | change))
        assert cli.main(["leaderboard", str(result)]) == 2
        assert message in capsys.readouterr().err
    for text, message in (("[1]", "no result of a suite"), ("{}", r"it has no field 'checksum'.*mecp-env submit")):
        result.write_text(text)
        with pytest.raises(ConfigError, match=message):
            read_submission(result)
    for path, message in ((result.parent, "a folder, or no plain file"), (result.with_name("x"), "x: No such file")):
        with pytest.raises(ConfigError, match=message):
            read_submission(path)


def test_a_suite_that_this_version_would_change_is_refused(toy: str, monkeypatch: pytest.MonkeyPatch) -> None:
    frozen = SUITES[toy].frozen
    monkeypatch.setitem(SUITES, toy, Suite(SMALL, 3, frozen))
    definition_hash.cache_clear()
    with pytest.raises(ConfigError, match=f"published with the hash {frozen}, this mecp_env has"):
        find_suite(toy)


class LongSight(Nearest):
    """A policy that asks for another laser."""

    settings: ClassVar[dict[str, Any]] = {"observation": {"map": True}, "laser": {"max_range_m": 30.0}}


class Broken(Nearest):
    """A policy with a bug, which the first actions do not show: they are tried with the seed 0."""

    def reset(self, seed: int = 0) -> None:
        super().reset(seed)
        if seed == 1:
            raise RuntimeError("a bug")


def test_a_policy_that_changes_the_robot_of_a_suite_is_refused(toy: str, tmp_path: Path, capsys: Captured) -> None:
    line = ["evaluate", "nearest", f"{__name__}:LongSight", "--suite", toy, "--out", str(tmp_path / "out")]
    assert cli.main(line) == 2
    assert "LongSight' has settings of laser; a suite fixes layout, start," in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_without_all_episodes_there_is_no_result_and_the_user_knows_why(
    toy: str, tmp_path: Path, capsys: Captured
) -> None:
    line = ["evaluate", f"{__name__}:Broken", "--suite", toy, "--no-truth", "--out", str(tmp_path)]
    assert cli.main(line) == 1
    assert "1 episodes failed: no result; the same command repeats them" in capsys.readouterr().err
    assert not (tmp_path / f"{toy}.json").exists()


def test_a_task_is_evaluated_with_known_correspondences_too(tmp_path: Path, capsys: Captured) -> None:
    line = "evaluate nearest --task ActiveCheapRobot-v0 --known --split validation --episodes 1 --max-steps 12 --out"
    assert cli.main([*line.split(), str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "1 buildings: ActiveCheapRobot-v0, split validation" in said
    assert "nearest, known correspondences" in said


@pytest.fixture
def referenced(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> str:
    """A suite of one short episode with one reference row."""
    name = add_toy(monkeypatch, (Setting("easy", "validation", "slam", 25),), 1)
    row = {"task": "easy", "policy": "nearest", "estimator": "slam", "figures": FIGURES, "hours": 0.5}
    content = {"suite": name, "hash": SUITES[name].frozen, "results": [row]}
    (tmp_path / "references").mkdir()
    (tmp_path / "references" / f"{name}.json").write_text(json.dumps(content))
    monkeypatch.setattr(suites, "FOLDER", tmp_path / "references")
    return name


class TwoActions(Nearest):
    """A class that contradicts itself."""

    settings: ClassVar[dict[str, Any]] = {"actions": "velocity"}


def test_a_class_becomes_a_row_beside_the_references(referenced: str, tmp_path: Path, capsys: Captured) -> None:
    path, policy = tmp_path / "mine.json", "tests.policies.scenes:FlatDriver"
    line = ["submit", policy, "--suite", referenced, "--name", "mine", "--seeds", "3", "--out", str(path)]
    assert cli.main([*line, "--hours", "1.5"]) == 0
    out = capsys.readouterr().out
    assert "| | easy | hours | seeds |" in out
    assert "| nearest (reference) | 0.500 [0.400, 0.600] | 0.5 | - |" in out
    content = read_submission(path)
    assert [row["policy"] for row in content["results"]] == ["mine"]
    assert (content["hours"], content["seeds"]) == (1.5, 3)
    assert cli.main(["leaderboard", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if line.startswith("| mine |") and line.endswith("| 1.5 | 3 |")]
    assert cli.main(["leaderboard", str(path), "--no-references"]) == 0
    assert "(reference)" not in capsys.readouterr().out
    assert cli.main(["leaderboard", "--suite", referenced]) == 0
    assert "nearest (reference)" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["gain", "maskable_ppo", "a|b", "a\nb", "[a](b)", " ", "a" * 90])
def test_a_name_that_forges_a_row_is_refused(name: str, referenced: str, tmp_path: Path, capsys: Captured) -> None:
    line = ["submit", "nearest", "--suite", referenced, "--name", name, "--out", str(tmp_path / "mine.json")]
    assert cli.main(line) == 2
    assert capsys.readouterr().err.startswith("mecp-env: name: ")
    assert not (tmp_path / "mine.json").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"policy": "x | 0.1 |\n| gain | 0.999 |"}, "results: policy: "),
        ({"task": "easy |"}, "expected one of easy"),
        ({"estimator": "slam | 1 |"}, "expected one of slam, known, truth"),
        ({}, "hours, seeds: "),
    ],
)
def test_a_file_that_forges_a_row_is_refused(
    change: dict[str, Any], message: str, referenced: str, tmp_path: Path, capsys: Captured
) -> None:
    row = {"task": "easy", "policy": "mine", "estimator": "slam", "figures": FIGURES, "episodes": []}
    content = {"format": "mecp_env/suite", "version": 1, "suite": referenced, "hash": SUITES[referenced].frozen}
    content["results"] = [row | change]
    path = tmp_path / "forged.json"
    path.write_text(json.dumps(signed(content if change else content | {"hours": "9 | 9"})))
    assert cli.main(["leaderboard", str(path)]) == 2
    assert message in capsys.readouterr().err


def test_no_name_adds_a_line_or_a_column() -> None:
    row = {"task": "t|\n|x", "policy": "p | 0.1 |\n| gain (reference)", "estimator": "slam", "figures": FIGURES}
    best = row | {"figures": {**FIGURES, METRICS[0]: {"value": 1.0, "low": 1.0, "high": 1.0}}}
    lines = leaderboard({"f|\n": {"results": [row]}, "g": {"results": [best]}}).split("\n")
    assert [line.count("|") for line in lines] == [3, 3, 3, 3]
    assert not any("(reference)" in line for line in lines)
    assert safe_name("runs/my-run_1: v2") == check_name("runs/my-run_1: v2")
    own = {"task": "t", "policy": "gain", "estimator": "slam", "figures": FIGURES}
    better = own | {"figures": {metric: {"value": 0.9, "low": 0.8, "high": 1.0} for metric in METRICS}}
    lines = leaderboard({"a": {"results": [own]}, "b": {"results": [better]}}, references=[own]).split("\n")[2:]
    assert [line.split(" |")[0] for line in lines] == ["| gain, b", "| gain (reference)"]  # one that repeats it is out


@pytest.mark.parametrize("name", SUITES)
def test_the_package_contains_reference_rows_of_each_suite(name: str) -> None:
    rows = reference_rows(name, SUITES[name].frozen)
    assert {"nearest", "next_best_view"} <= {row["policy"] for row in rows}
    assert all(set(METRICS) == set(row["figures"]) for row in rows)
    assert reference_rows(name, "another") == []
    assert (suites.FOLDER / f"{name}.json").stat().st_size < 20_000
