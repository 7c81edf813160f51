"""`mecp-env play`: drive by keyboard."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from mecp_env.cli.base import Command, check_folder
from mecp_env.cli.buildings import SERIES, expand, resolve
from mecp_env.cli.exit_codes import echo
from mecp_env.cli.fields import Fields, configuration
from mecp_env.core.errors import ConfigError

if TYPE_CHECKING:
    from mecp_env.cli.play_game import Game
    from mecp_env.env import MecpEnv
    from mecp_env.render.window import Window

RATES = (0.5, 30.0)


@dataclass(frozen=True)
class Play(Command):
    """Drive through a building by keyboard: left the world, right what the robot believes of it. The keys are listed in
    the window: arrows or W A S D drive, Shift slowly, Space waits, H hides the world, P keeps a picture, R begins
    again, N takes the next building of a series or folder, or else the next seed, Esc quits."""

    examples: ClassVar[tuple[str, ...]] = (
        "mecp-env play",
        "mecp-env play --layout medium:0",
        "mecp-env play --layout runs/worlds --rate 10",
        "mecp-env play --layout office --config.slam.filter.kind ekf --config.start random",
    )

    layout: str = "two_rooms"  # a shipped name, DIFFICULTY:SEED, DIFFICULTY:FIRST-LAST, a plan, or a folder of plans
    seed: int = 0  # of the noise
    rate: float = 6.0  # control steps of 0.4 s per second, while a key is held; 2.5 is real time
    out: Path = Path("runs/play")  # folder for pictures (P)
    config: Fields = field(default_factory=Fields)  # any field of the configuration

    def run(self, line: Sequence[str]) -> int:
        """Drive until the window is closed."""
        from mecp_env.cli.play_game import Game  # pygame and physics are loaded only here
        from mecp_env.env import MecpEnv
        from mecp_env.render.window import Window, require_display

        self._check()
        words = expand(self.layout)
        first = MecpEnv(configuration(resolve(words[0]), self.config, line))  # before the window: it may be refused
        require_display()

        def make(number: int) -> tuple[MecpEnv, int]:
            word, seed = later(words, self.seed, number)
            return first if word == words[0] else MecpEnv(configuration(resolve(word), self.config, line)), seed

        game, window = Game(make, self.out), Window("mecp_env: play")
        try:
            loop(game, window, self.rate)
        finally:
            window.close()
        echo(game.result)
        return 0

    def _check(self) -> None:
        check_folder(self.out)
        if self.seed < 0:
            raise ConfigError(f"seed: {self.seed}, at least 0")
        if not RATES[0] <= self.rate <= RATES[1]:
            raise ConfigError(f"rate: {self.rate:g}, from {RATES[0]:g} to {RATES[1]:g} steps per second")


def later(words: Sequence[str], seed: int, number: int) -> tuple[str, int]:
    """Building and seed of a round: of several buildings one after the other, of one seed of a difficulty the next.

    A building that is alone is always the same, its noise another each time; so is the noise when all had their turn.
    """
    preset, colon, first = words[0].partition(":")
    if len(words) == 1 and SERIES.fullmatch(words[0]):
        return f"{preset}{colon}{int(first) + number}", seed
    return words[number % len(words)], seed + number // len(words)


def loop(game: Game, window: Window, rate: float) -> None:
    """Events, a step, a picture, until the user has had enough."""
    import pygame

    clock = pygame.time.Clock()
    window.draw(game.frame())
    while not (game.done or window.closed):
        clock.tick(rate)
        for event in window.events():
            game.handle(event)
        game.advance()
        if game.changed:
            window.draw(game.frame())
