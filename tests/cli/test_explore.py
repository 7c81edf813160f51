"""`mecp-env explore`: one episode of a policy; wrong input; how commands end."""

from pathlib import Path

import pytest

from mecp_env.cli import main as cli
from mecp_env.cli.base import run_command
from mecp_env.core.errors import ConfigError
from mecp_env.slam import MapError, SlamPipeline
from mecp_env.world.layout import LIBRARY
from tests.cli.pipes import closed_pipe

Captured = pytest.CaptureFixture[str]


def test_a_building_of_a_task_has_its_robot_and_a_random_start(capsys: Captured) -> None:
    assert cli.main(["explore", "pause", "--layout", "ActiveCheapRobot-v0:validation:3", "--steps", "20"]) == 0
    said = capsys.readouterr().out
    assert "out of steps after 20 control steps" in said
    assert "correct_coverage_over_steps" in said


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


def test_difficulty_task_and_split_name_the_building_that_evaluate_names(capsys: Captured) -> None:
    ends = ["--seed", "3", "--start", "random", "--steps", "5"]
    shown = []
    for place in (["--layout", "easy:validation:3"], ["--difficulty", "easy", "--split", "validation"]):
        assert cli.main(["explore", "nearest", *place, *ends]) == 0
        shown.append(capsys.readouterr().out)
    assert shown[0] == shown[1]
    assert "out of steps after 5 control steps" in shown[0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--layout easy:test", "easy:test: seeds are whole numbers"),
        ("--layout easy:test:0-3", "'easy:test:0-3', expected DIFFICULTY:SPLIT:NUMBER"),
        ("--layout esy:test:1", "did you mean 'easy'?"),
        ("--layout ActiveHall-v0:test:1", "did you mean 'ActiveHalls-v0'?"),
        ("--layout easy:tst:1", "did you mean 'test'?"),
        ("--layout easy:test:1000000", "building: 1000000"),
        ("--layout a\x1b[31mb", "a?[31mb: no such file"),
        ("--layout two_rooms --steps 0", "--steps: Input should be greater than or equal to 1 (given: 0)"),
        ("--layout paper --difficulty hard", "--difficulty hard: --layout paper fixes it"),
        ("--difficulty hard --task ActiveHalls-v0", "--difficulty hard: --task ActiveHalls-v0 fixes it"),
        ("--difficulty hrd", "did you mean 'hard'?"),
        ("--task ActiveHall-v0", "did you mean 'ActiveHalls-v0'?"),
        ("--difficulty hard --split tst", "did you mean 'test'?"),
        ("--split test", "of the buildings of --difficulty or --task"),
        ("--policy", "did you mean 'nearest'?"),
        ("--layout plan.json --save-map .", "--save-map: . is a folder, not a file"),
        ("--layout plan.json --save-map plan.json/map.zip", "plan.json is a file, not a folder"),
        ("--layout plan.json --save-map plan.json", "plan.json is what is read"),
        ("--layout plan.json --save-map notes.txt", "notes.txt: no mecp_env map, or cut short; name another file"),
        ("--save-map map.zip --estimator known", "map.zip: a map of the estimator 'known' localises with ground truth"),
    ],
)
def test_wrong_input_ends_with_2_and_one_line_and_changes_nothing(
    options: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    monkeypatch.chdir(tmp_path)
    files = {"plan.json": (LIBRARY / "two_rooms.json").read_bytes(), "notes.txt": b"mine"}
    for name, data in files.items():
        Path(name).write_bytes(data)
    line = ["nearst"] if options == "--policy" else ["nearest", *options.split()]
    assert cli.main(["explore", *line]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.startswith("mecp-env: ")
    assert err.count("\n") == 1
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == files


def test_the_map_of_an_exploration_can_be_localised_in(tmp_path: Path, capsys: Captured) -> None:
    path = tmp_path / "new" / "two_rooms.zip"
    line = ["explore", "nearest", "--layout", "two_rooms", "--steps", "10", "--save-map", str(path)]
    assert cli.main(line) == 0
    assert f"map: {path}" in capsys.readouterr().out
    with closed_pipe():
        assert cli.main(line) == 0  # a map replaces a map, also where the reader has gone
    assert capsys.readouterr().err.count("the output pipe is closed") == 1
    loaded = SlamPipeline.from_map(path)
    assert loaded.step_count == 13  # three scans at rest
    assert len(loaded.filter.ids) >= 4
