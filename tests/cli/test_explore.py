"""`mecp-env explore`: one episode of a policy; wrong input; how commands end."""

from pathlib import Path

import pytest

from mecp_env.cli import main as cli
from mecp_env.cli.base import run_command
from mecp_env.core.errors import ConfigError
from mecp_env.slam import MapError, SlamPipeline

Captured = pytest.CaptureFixture[str]


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


def test_task_and_split_name_the_building_and_robot_that_evaluate_names(capsys: Captured) -> None:
    shown = []
    for place in ("--layout ActiveCheapRobot-v0:validation:3", "--task ActiveCheapRobot-v0 --split validation"):
        line = f"explore pause {place} --seed 3 --start random --steps 20"
        assert cli.main(line.split()) == 0
        shown.append(capsys.readouterr().out)
    assert shown[0] == shown[1]
    assert "out of steps after 20 control steps" in shown[0]
    assert "correct_coverage_over_steps" in shown[0]


def test_the_map_of_an_exploration_can_be_localised_in(tmp_path: Path, capsys: Captured) -> None:
    path = tmp_path / "new" / "two_rooms.zip"
    line = ["explore", "nearest", "--layout", "two_rooms", "--steps", "10", "--save-map", str(path)]
    assert cli.main(line) == 0
    assert f"map: {path}" in capsys.readouterr().out
    assert cli.main(line) == 0  # a map replaces a map
    loaded = SlamPipeline.from_map(path)
    assert loaded.step_count == 13  # three scans at rest
    assert len(loaded.filter.ids) >= 4
