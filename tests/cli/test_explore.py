"""`mecp-env explore`: one episode of a policy; wrong input; how commands end."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from mecp_env.cli import main as cli
from mecp_env.cli.exit_codes import run_command
from mecp_env.core.errors import ConfigError
from mecp_env.policies.registry import EXPLORERS
from mecp_env.slam import MapError, SlamPipeline
from mecp_env.world.layout import LIBRARY
from tests.cli.pipes import closed_pipe

Captured = pytest.CaptureFixture[str]


@pytest.mark.parametrize("policy", EXPLORERS)
def test_every_explorer_explores(policy: str, capsys: Captured) -> None:
    assert cli.main(["explore", policy, "--layout", "two_rooms", "--steps", "60"]) == 0
    out = capsys.readouterr().out
    assert "control steps" in out
    assert "coverage" in out


def test_a_generated_building_is_selected_by_its_number(capsys: Captured) -> None:
    assert cli.main(["explore", "nearest", "--layout", "easy:test:3", "--steps", "5"]) == 0
    assert "out of steps after 5" in capsys.readouterr().out


def test_a_building_of_a_task_has_its_robot_and_a_random_start(capsys: Captured) -> None:
    assert cli.main(["explore", "pause", "--layout", "ActiveCheapRobot-v0:validation:3", "--steps", "20"]) == 0
    said = capsys.readouterr().out
    assert "out of steps after 20 control steps" in said
    assert "correct_coverage_over_steps" in said


def test_explore_takes_the_buildings_that_the_demo_takes(capsys: Captured) -> None:
    assert cli.main(["explore", "nearest", "--layout", "easy:3", "--steps", "5"]) == 0
    assert "out of steps after 5" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--layout easy:test", "easy:test: seeds are whole numbers"),
        ("--layout easy:test:x", "'easy:test:x', expected DIFFICULTY:SPLIT:NUMBER"),
        ("--layout easy:test:0-3", "'easy:test:0-3', expected DIFFICULTY:SPLIT:NUMBER"),
        ("--layout esy:test:1", "did you mean 'easy'?"),
        ("--layout ActiveHall-v0:test:1", "did you mean 'ActiveHalls-v0'?"),
        ("--layout easy:tst:1", "did you mean 'test'?"),
        ("--layout easy:test:1000000", "building: 1000000"),
        ("--layout nope", "nope"),
        ("--layout a\x1b[31mb", "a?[31mb: no such file"),
        ("--layout two_rooms --steps 0", "--steps: Input should be greater than or equal to 1 (given: 0)"),
        ("--seed -1", "--seed: Input should be greater than or equal to 0 (given: -1)"),
    ],
)
def test_wrong_input_ends_with_2_and_one_line(options: str, message: str, capsys: Captured) -> None:
    assert cli.main(["explore", "random_walk", *options.split()]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.startswith("mecp-env: ")
    assert err.count("\n") == 1


def test_the_map_of_an_exploration_can_be_localised_in(tmp_path: Path, capsys: Captured) -> None:
    path = tmp_path / "new" / "two_rooms.zip"
    line = ["explore", "nearest", "--layout", "two_rooms", "--steps", "10", "--save-map", str(path)]
    for _ in range(2):  # a map replaces a map
        assert cli.main(line) == 0
    assert f"map: {path}" in capsys.readouterr().out
    loaded = SlamPipeline.from_map(path)
    assert loaded.step_count == 13  # three scans at rest
    assert len(loaded.filter.ids) >= 4


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--save-map .", "--save-map: . is a folder, not a file"),
        ("--save-map plan.json/map.zip", "plan.json is a file, not a folder"),
        ("--save-map plan.json", "plan.json is what is read"),
        ("--save-map notes.txt", "notes.txt: no mecp_env map, or cut short; name another file"),
        ("--save-map map.zip --estimator known", "map.zip: a map of the estimator 'known' localises with ground truth"),
    ],
)
def test_a_map_is_refused_before_the_exploration(
    options: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    monkeypatch.chdir(tmp_path)
    plan = (LIBRARY / "two_rooms.json").read_bytes()
    Path("plan.json").write_bytes(plan)
    Path("notes.txt").write_text("mine")
    assert cli.main(["explore", "nearest", "--layout", "plan.json", *options.split()]) == 2
    assert message in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["notes.txt", "plan.json"]
    assert Path("notes.txt").read_text() == "mine"
    assert Path("plan.json").read_bytes() == plan


def test_an_unknown_policy_gets_a_suggestion(capsys: Captured) -> None:
    assert cli.main(["explore", "nearst"]) == 2
    assert "did you mean 'nearest'?" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (ConfigError("plan: a\x1b[31mb"), 2, "mecp-env: plan: a?[31mb\n"),
        (FileNotFoundError(2, "No such file", "x\x07.json"), 2, "mecp-env: x?.json: No such file\n"),
        (KeyboardInterrupt(), 130, "mecp-env: interrupted\n"),
    ],
)
def test_an_error_is_one_line_without_control_characters(
    error: BaseException, code: int, message: str, capsys: Captured
) -> None:
    def fail() -> int:
        raise error

    assert run_command(fail) == code
    assert capsys.readouterr().err == message


@pytest.mark.slow
def test_a_closed_pipe_gives_no_traceback() -> None:
    command = [sys.executable, "-m", "mecp_env", "explore", "nearest", "--layout", "two_rooms", "--steps", "20"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as running:
        assert running.stdout is not None
        assert running.stderr is not None
        running.stdout.close()
        assert b"Traceback" not in running.stderr.read()
    assert running.returncode == 0


def test_difficulty_task_and_split_name_the_building_that_evaluate_names(capsys: pytest.CaptureFixture[str]) -> None:
    ends = ["--seed", "3", "--start", "random", "--steps", "5"]
    shown = []
    for place in (["--layout", "easy:validation:3"], ["--difficulty", "easy", "--split", "validation"]):
        assert cli.main(["explore", "nearest", *place, *ends]) == 0
        shown.append(capsys.readouterr().out)
    assert shown[0] == shown[1]


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("--layout paper --difficulty hard", "--difficulty hard: --layout paper fixes it"),
        ("--difficulty hard --task ActiveHalls-v0", "--difficulty hard: --task ActiveHalls-v0 fixes it"),
        ("--difficulty hrd", "did you mean 'hard'?"),
        ("--task ActiveHall-v0", "did you mean 'ActiveHalls-v0'?"),
        ("--difficulty hard --split tst", "did you mean 'test'?"),
        ("--split test", "of the buildings of --difficulty or --task"),
    ],
)
def test_words_that_do_not_name_one_building_are_refused(
    line: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["explore", "nearest", *line.split()]) == 2
    assert told in capsys.readouterr().err


def test_an_exploration_that_cannot_save_its_map_keeps_everything_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    def save_map(self: SlamPipeline, path: Path) -> None:
        raise MapError("map: damaged")

    monkeypatch.setattr(SlamPipeline, "save_map", save_map)
    saved, played = tmp_path / "map.zip", tmp_path / "played"
    line = ["explore", "nearest", "--layout", "two_rooms", "--steps", "10", "--save-map", str(saved)]
    assert cli.main([*line, "--replay", str(played)]) == 1
    said = capsys.readouterr()
    assert "coverage" in said.out
    assert f"{saved} was not written: map: damaged" in said.err
    assert [path.name for path in played.iterdir()] == ["episode-0000.html"]


def test_an_exploration_whose_reader_is_gone_keeps_its_map(tmp_path: Path, capsys: Captured) -> None:
    saved = tmp_path / "map.zip"
    line = ["explore", "nearest", "--layout", "two_rooms", "--steps", "10", "--save-map", str(saved)]
    with closed_pipe():
        assert cli.main(line) == 0
    assert SlamPipeline.from_map(saved).step_count == 13
    assert capsys.readouterr().err.count("the output pipe is closed") == 1
