"""`mecp-env play` without a display: events drive the robot, requested views are shown and saved."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pygame
import pytest

from mecp_env.cli import main as cli
from mecp_env.cli.options import Reading
from mecp_env.cli.play import Game, later
from mecp_env.env import MecpEnv
from mecp_env.render import palette
from mecp_env.world.layout import load_layout

Said = pytest.CaptureFixture[str]
Key = int


@pytest.fixture
def game(tmp_path: Path) -> Game:
    env = MecpEnv(layout="two_rooms", max_steps=12)
    return Game(lambda number: (env, number), tmp_path / "pictures")


def press(game: Game, *keys: Key) -> None:
    for key in keys:
        game.handle(pygame.event.Event(pygame.KEYDOWN, key=key))


def release(game: Game, *keys: Key) -> None:
    for key in keys:
        game.handle(pygame.event.Event(pygame.KEYUP, key=key))


def script(monkeypatch: pytest.MonkeyPatch, *ticks: list[tuple[int, Key]]) -> None:
    """Each tick of the clock delivers the next events; after the last one the window closes."""

    class Clock:
        left = iter([*ticks, [(pygame.QUIT, 0)]])

        def tick(self, rate: float) -> None:
            for kind, key in next(self.left):
                pygame.event.post(pygame.event.Event(kind, key=key))

    monkeypatch.setattr(pygame.time, "Clock", Clock)
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


@pytest.mark.parametrize(
    ("keys", "action"),
    [
        ([pygame.K_w, pygame.K_LEFT], (1.0, 0.5)),
        ([pygame.K_UP, pygame.K_DOWN], (0.0, 0.0)),
        ([pygame.K_UP, pygame.K_LSHIFT], (0.35, 0.0)),
    ],
)
def test_keys_are_shares_of_speed_and_turn(game: Game, keys: list[Key], action: tuple[float, float]) -> None:
    press(game, *keys)
    assert game.action() == pytest.approx(action)
    assert game.env.action_space.contains(game.action())


def test_a_tap_is_one_step_a_held_key_drives_and_a_released_one_lets_the_robot_roll_out(game: Game) -> None:
    press(game, pygame.K_SPACE)
    release(game, pygame.K_SPACE)
    for _ in range(2):
        game.advance()
    assert game.env.summary()["periods"] == 1
    press(game, pygame.K_UP)
    for _ in range(3):
        game.advance()
    assert game.env.summary()["periods"] == 4
    release(game, pygame.K_UP)
    for _ in range(6):
        game.advance()
    assert 4 < game.env.summary()["periods"] < 10  # the robot stops, and time stops
    assert game.env.summary()["metres"] > 0.3
    press(game, pygame.K_UP)
    game.handle(pygame.event.Event(pygame.WINDOWFOCUSLOST))
    assert not game.held


def test_the_end_of_an_episode_is_told_and_the_next_round_has_another_seed(game: Game) -> None:
    press(game, pygame.K_SPACE)
    for _ in range(13):
        game.advance()
    assert game.message.startswith("Time is up. N begins")
    first = game.view.slam_output.beams.ranges
    press(game, pygame.K_r)
    again = game.view.slam_output.beams.ranges
    press(game, pygame.K_n)
    assert game.env.summary()["periods"] == 0
    assert not game.over
    assert len(first) == len(again)
    assert not np.array_equal(again, game.view.slam_output.beams.ranges)


def test_the_world_can_be_hidden(game: Game) -> None:
    def dark() -> float:
        return float((game.frame()[60:480, :600] == palette.SOLID).all(axis=2).mean())

    assert dark() > 0.01
    press(game, pygame.K_h)
    assert dark() == 0.0


def test_a_picture_is_kept_or_the_window_says_why_not(game: Game, tmp_path: Path) -> None:
    press(game, pygame.K_p)
    (picture,) = (tmp_path / "pictures").iterdir()
    assert picture.name == "two_rooms-slam-step-0.png"
    assert str(picture) in game.message
    game.folder = picture / "below-a-file"
    press(game, pygame.K_p)
    assert "--out" in game.message
    game.folder, game.view = tmp_path / "pictures", replace(game.view, title="../../up, slam, step 3")
    press(game, pygame.K_p)
    assert {path.name for path in (tmp_path / "pictures").iterdir()} == {picture.name, "up-slam-step-3.png"}


def test_a_drive_from_the_command_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Said) -> None:
    down, up = (pygame.KEYDOWN, pygame.K_UP), (pygame.KEYUP, pygame.K_UP)
    script(monkeypatch, [down], [], [up], [(pygame.KEYDOWN, pygame.K_h)])
    monkeypatch.chdir(tmp_path)
    assert cli.main(["play", "--layout", "two_rooms", "--config.estimator", "truth"]) == 0
    said = capsys.readouterr().out.splitlines()[-1]
    assert said.startswith("two_rooms, truth, step ")
    assert "coverage" in said
    assert not pygame.display.get_init()
    assert list(tmp_path.iterdir()) == []

    def stop(clock: object, rate: float) -> None:
        assert pygame.display.get_init()
        raise KeyboardInterrupt

    monkeypatch.setattr(pygame.time.Clock, "tick", stop)
    assert cli.main(["play", "--layout", "two_rooms"]) == 130
    assert not pygame.display.get_init()


def test_rounds_take_one_building_after_the_other() -> None:
    for layout, rounds in {
        "two_rooms": [("two_rooms", 5), ("two_rooms", 6)],
        "easy:7": [("easy:7", 5), ("easy:8", 5)],
        "easy:7-8": [("easy:7", 5), ("easy:8", 5), ("easy:7", 6)],
    }.items():
        assert [later(Reading().expand(layout), 5, number) for number in range(len(rounds))] == rounds


def test_next_walks_through_a_folder_and_tells_of_a_damaged_plan(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Said
) -> None:
    for name in ("paper", "two_rooms"):
        (tmp_path / f"{name}.json").write_text(load_layout(name).to_json())
    (tmp_path / "q.json").write_text("{")
    told: list[str] = []
    advance = Game.advance
    monkeypatch.setattr(
        Game, "advance", lambda game: (told.append(f"{game.view.title}: {game.message}"), advance(game))
    )
    script(monkeypatch, *[[(pygame.KEYDOWN, pygame.K_n)]] * 3)
    assert cli.main(["play", "--layout", str(tmp_path)]) == 0
    assert f"paper, slam, step 0: Round 2 cannot begin, N takes the next: {tmp_path}/q.json: no JSON" in told[0]
    assert told[1].startswith("two_rooms, slam, step 0: Time stands still")
    assert capsys.readouterr().out.startswith("paper, slam, step 0")
