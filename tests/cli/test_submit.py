"""`mecp-env submit` and the reference rows of `mecp-env leaderboard`."""

import json
from pathlib import Path
from typing import Any, ClassVar

import pytest

from mecp_env.cli import main as cli
from mecp_env.policies import suites
from mecp_env.policies.explorers import Nearest
from mecp_env.policies.setting import Setting
from mecp_env.policies.suites import (
    METRICS,
    SUITES,
    check_name,
    leaderboard,
    read_submission,
    reference_rows,
    safe_name,
)
from tests.policies.test_suites import add_toy, signed

Captured = pytest.CaptureFixture[str]
FIGURES = {metric: {"value": 0.5, "low": 0.4, "high": 0.6} for metric in METRICS}


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> str:
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


def test_a_class_becomes_a_row_beside_the_references(toy: str, tmp_path: Path, capsys: Captured) -> None:
    path, policy = tmp_path / "mine.json", "tests.policies.scenes:FlatDriver"
    line = ["submit", policy, "--suite", toy, "--name", "mine", "--seeds", "3", "--out", str(path)]
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
    assert cli.main(["leaderboard", "--suite", toy]) == 0
    assert "nearest (reference)" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["gain", "maskable_ppo", "a|b", "a\nb", "[a](b)", " ", "a" * 90])
def test_a_name_that_forges_a_row_is_refused(name: str, toy: str, tmp_path: Path, capsys: Captured) -> None:
    line = ["submit", "nearest", "--suite", toy, "--name", name, "--out", str(tmp_path / "mine.json")]
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
    change: dict[str, Any], message: str, toy: str, tmp_path: Path, capsys: Captured
) -> None:
    row = {"task": "easy", "policy": "mine", "estimator": "slam", "figures": FIGURES, "episodes": []}
    content = {"format": "mecp_env/suite", "version": 1, "suite": toy, "hash": SUITES[toy].frozen}
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
