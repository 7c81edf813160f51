"""`mecp-env play`: drive by keyboard."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from mecp_env.commands.base import Command, check_writable
from mecp_env.commands.buildings import SERIES, resolve
from mecp_env.commands.fields import Fields, configuration
from mecp_env.errors import ConfigError

if TYPE_CHECKING:
    from mecp_env.commands.play_game import Game
    from mecp_env.env import MecpEnv
    from mecp_env.render.window import Window

RATES = (0.5, 30.0)


@dataclass(frozen=True)
class Play(Command):
    """Drive through a building by keyboard: left the world, right what the robot believes of it. The keys are listed in
    the window: arrows or W A S D drive, Shift slowly, Space waits, H hides the world, P keeps a picture, R begins
    again, N takes the next building of a series or the next seed, Esc quits."""

    examples: ClassVar[tuple[str, ...]] = (
        "mecp-env play",
        "mecp-env play --layout medium:0",
        "mecp-env play --layout office --config.slam.filter.kind ekf --config.start random",
    )

    layout: str = "two_rooms"  # a shipped name (paper, two_rooms, ...), DIFFICULTY:SEED, or the path of a file
    seed: int = 0  # of the noise
    rate: float = 6.0  # control periods of 0.4 s a second, while a key is held; 2.5 is real time
    out: Path = Path("runs/play")  # folder for pictures (P)
    config: Fields = field(default_factory=Fields)  # any field of the configuration

    def run(self, line: Sequence[str]) -> int:
        """Drive until the window is closed."""
        from mecp_env.commands.play_game import Game  # pygame and physics are loaded only here
        from mecp_env.env import MecpEnv
        from mecp_env.render.window import Window, require_display

        self._check()
        first = MecpEnv(configuration(resolve(self.layout), self.config, line))  # before the window: it may be refused
        require_display()

        def make(number: int) -> tuple[MecpEnv, int]:
            if not SERIES.fullmatch(self.layout):
                return first, self.seed + number
            return MecpEnv(configuration(resolve(later(self.layout, number)), self.config, line)), self.seed

        game, window = Game(make, self.out), Window("mecp_env: play")
        try:
            loop(game, window, self.rate)
        finally:
            window.close()
        print(game.result)
        return 0

    def _check(self) -> None:
        check_writable(self.out)
        if self.seed < 0:
            raise ConfigError(f"seed: {self.seed}, at least 0")
        if not RATES[0] <= self.rate <= RATES[1]:
            raise ConfigError(f"rate: {self.rate:g}, from {RATES[0]:g} to {RATES[1]:g} periods a second")


def later(word: str, number: int) -> str:
    """The building so many seeds after a generated one."""
    preset, _, seed = word.partition(":")
    return f"{preset}:{int(seed) + number}"


def loop(game: Game, window: Window, rate: float) -> None:
    """Events, a period, a picture, until the user has had enough."""
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
