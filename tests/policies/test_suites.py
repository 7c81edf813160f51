"""Frozen benchmarks: one file per result, refused where it cannot be compared."""

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
from mecp_env.policies.suites import SUITES, Suite, definition_hash, find_suite, leaderboard, read_submission

SMALL = (Setting("easy", "validation", "slam", 40), Setting("", "validation", "slam", 40, "ActiveCheapRobot-v0"))


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


def test_what_cannot_be_compared_is_refused(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = json.loads(result.read_text())
    for change, message in (
        ({"hash": "0123"}, "suite toy-v1 with the hash 0123, here"),
        ({"version": 7}, "version 7, this mecp_env reads mecp_env/suite version 1"),
        ({"suite": ["toy-v9"]}, "suite ['toy-v9'], this mecp_env has"),
        ({"results": []}, f"its checksum is {content['checksum']}, that of its content "),
        (signed(content | {"results": [{"task": "easy"}]}), "results: "),
        (
            signed(content | {"results": [content["results"][0] | {"figures": {}}]}),
            "nearest in easy has no correct_over",
        ),
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


class OtherEstimator(Nearest):
    """A policy that asks for another estimator."""

    settings: ClassVar[dict[str, Any]] = {"slam": {"panorama": {"use": "always"}}}


@pytest.mark.parametrize(("policy", "section"), [(LongSight, "laser"), (OtherEstimator, "slam")])
def test_a_policy_that_changes_robot_or_estimator_of_a_suite_is_refused(
    toy: str, tmp_path: Path, policy: type, section: str, capsys: pytest.CaptureFixture[str]
) -> None:
    line = ["evaluate", "nearest", f"{__name__}:{policy.__name__}", "--suite", toy, "--out", str(tmp_path / "out")]
    assert cli.main(line) == 2
    assert f"{policy.__name__}' has settings of {section}; a suite fixes layout, start," in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_without_all_episodes_there_is_no_result_and_the_user_knows_why(
    toy: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = ["evaluate", f"{__name__}:Broken", "--suite", toy, "--no-truth", "--out", str(tmp_path)]
    assert cli.main(line) == 1
    assert "1 episodes failed: no result; the same command repeats them" in capsys.readouterr().err
    assert not (tmp_path / f"{toy}.json").exists()


def test_a_task_is_evaluated_with_known_correspondences_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = "evaluate nearest --task ActiveCheapRobot-v0 --known --split validation --episodes 1 --max-steps 12 --out"
    assert cli.main([*line.split(), str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "1 buildings: ActiveCheapRobot-v0, split validation" in said
    assert "nearest, known correspondences" in said
