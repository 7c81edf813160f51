"""`mecp-env play`: drive by keyboard."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pygame
from numpy.typing import NDArray
from PIL import Image as Pictures
from pydantic import Field

from mecp_env.cli.base import Line, OutFolder, Seed, echo
from mecp_env.cli.options import SERIES, Fields, ReadsPlans, WithModules, configuration
from mecp_env.core.carriers import Bytes
from mecp_env.core.errors import MecpError
from mecp_env.env import MecpEnv
from mecp_env.render.replay import Recorder, write_page
from mecp_env.render.screen import Screen
from mecp_env.render.shapes import summary
from mecp_env.render.window import Window, key_strip, require_display

FORWARD, BACK = {pygame.K_UP, pygame.K_w}, {pygame.K_DOWN, pygame.K_s}
LEFT, RIGHT = {pygame.K_LEFT, pygame.K_a}, {pygame.K_RIGHT, pygame.K_d}
SLOW, WAIT = {pygame.K_LSHIFT, pygame.K_RSHIFT}, {pygame.K_SPACE}
STEPPING = FORWARD | BACK | LEFT | RIGHT | WAIT
QUIT = {pygame.K_ESCAPE, pygame.K_q}
KEYS = (
    "arrows or W A S D: drive    Shift: slowly    Space: wait and scan    H: hide the world    P: keep a picture    "
    "R: again    N: next    Esc: quit"
)
TURN, SLOWLY = 0.5, 0.35  # shares of the largest turn rate, and of both when slow
AT_REST_M = 1e-3  # the robot has stopped when it moved, or turned (rad), less than this in a step
NOT_IN_NAMES = re.compile(r"[^\w]+")  # of files: the building's own name may hold anything
HELP = "Time stands still while no key is held. Find every room and door; green rings are what is left to see."


@dataclass(frozen=True)
class Play(WithModules, ReadsPlans):
    """Drive through a building by keyboard: left the world, right what the robot believes of it. The keys are listed in
    the window: arrows or W A S D drive, Shift slowly, Space waits, H hides the world, P keeps a picture, R begins
    again, N takes the next building of a series or folder, or else the next seed, Esc quits.

    Examples:
        mecp-env play
        mecp-env play --layout medium:0
        mecp-env play --layout runs/worlds --rate 10
        mecp-env play --layout office --config.slam.filter.kind ekf --config.start random
    """

    layout: str = "two_rooms"  # a shipped name, DIFFICULTY:SEED, DIFFICULTY:FIRST-LAST, a plan, or a folder of plans
    seed: Seed = 0  # of the noise
    # control steps of 0.4 s per second, while a key is held; 2.5 is real time
    rate: Annotated[float, Field(ge=0.5, le=30.0)] = 6.0
    out: OutFolder = Path("runs/play")  # folder for pictures (P)
    replay: bool = False  # keep a page that plays each drive, in the folder for pictures
    config: Fields = field(default_factory=Fields)  # any field of the configuration

    def run(self, line: Line) -> int:
        """Drive until the window is closed."""
        words = self.reading.expand(self.layout)

        @lru_cache(maxsize=1)
        def building(word: str) -> MecpEnv:
            return MecpEnv(configuration(self.reading.resolve(word), self.config, line))

        def make(number: int) -> tuple[MecpEnv, int]:
            word, seed = later(words, self.seed, number)
            return building(word), seed

        building(words[0])  # before the window: it may be refused
        require_display()
        game, window = Game(make, self.out, self.replay), Window("mecp_env: play")
        try:
            loop(game, window, self.rate)
        finally:
            window.close()
        game.keep_replay()
        echo(game.result)
        return 0


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
    clock = pygame.time.Clock()
    window.draw(game.frame())
    while not (game.done or window.closed):
        clock.tick(rate)
        for event in window.events():
            game.handle(event)
        game.advance()
        if game.changed:
            window.draw(game.frame())


class Game:
    """One drive after the other, each begun with `make(round)`: the environment and the seed. It opens no window."""

    def __init__(self, make: Callable[[int], tuple[MecpEnv, int]], folder: Path, replay: bool = False) -> None:
        self.make, self.folder, self.replay = make, folder, replay
        self.recorder = Recorder()
        self.screen = Screen()
        self.held: set[int] = set()
        self.tapped: set[int] = set()  # pressed since the last step, perhaps released again
        self.round = 0
        self.hidden = self.done = False
        self.begin()

    def begin(self) -> None:
        """Start the present round from its beginning. Raises `MecpError` where there is none, and changes nothing."""
        env, seed = self.make(self.round)
        env.reset(seed=seed)
        self.keep_replay()
        self.env = env
        self.view, self.moving, self.over = self.env.view(), False, False
        self.message, self.changed = HELP, True
        self.recorder = Recorder(env.config.robot.period_s)
        self.record({})

    def handle(self, event: pygame.event.Event) -> None:
        """Take in what the user did."""
        if event.type == pygame.KEYDOWN:
            self.held.add(event.key)
            self.tapped.add(event.key)
            self.command(event.key)
        elif event.type == pygame.KEYUP:
            self.held.discard(event.key)
        elif event.type == pygame.WINDOWFOCUSLOST:
            self.held.clear()
        self.changed |= event.type in (pygame.KEYDOWN, pygame.WINDOWEXPOSED)

    def command(self, key: int) -> None:
        """What a key does once, when it is pressed."""
        if key == pygame.K_h:
            self.hidden = not self.hidden
        elif key == pygame.K_p:
            self.keep_picture()
        elif key in (pygame.K_r, pygame.K_n):
            self.round += key == pygame.K_n
            try:
                self.begin()
            except MecpError as error:  # its building cannot be used: the last round goes on
                self.message = f"Round {self.round + 1} cannot begin, N takes the next: {error}"
        self.done = self.done or key in QUIT

    def action(self) -> NDArray[np.float32]:
        """Shares of the largest speed and turn rate for the keys that are down."""
        down = self.held | self.tapped
        forward = bool(down & FORWARD) - bool(down & BACK)
        turn = TURN * (bool(down & LEFT) - bool(down & RIGHT))
        return np.array([forward, turn], np.float32) * (SLOWLY if down & SLOW else 1.0)

    def advance(self) -> None:
        """One control step, if a key asks for it or the robot still rolls."""
        wanted = bool((self.held | self.tapped) & STEPPING) or self.moving
        if wanted and not self.over:
            self.step()
        self.tapped.clear()

    def step(self) -> None:
        """One control step."""
        _, _, terminated, truncated, info = self.env.step(self.action())
        before, self.view = self.view.T_world_robot, self.env.view()
        self.record(info)
        self.moving = bool(np.abs(self.view.T_world_robot - before).max() > AT_REST_M)
        self.over = terminated or truncated
        self.changed = True
        if self.over:
            lost = "The filter diverged" if info["diverged"] else "Time is up"
            why = "Explored: nothing is left to see" if terminated else lost
            self.message = f"{why}. N begins the next round, R this one again."
        else:
            self.message = "The robot touches something." if info["contact"] else HELP

    def keep_picture(self) -> None:
        """Write the current frame as PNG; an error is shown in the window."""
        path = self.folder / f"{NOT_IN_NAMES.sub('-', self.view.title).strip('-')}.png"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            Pictures.fromarray(self.frame()).save(path)
            self.message = f"Kept {path}"
        except OSError as error:
            self.message = f"{path}: {error.strerror}; choose another place with --out"

    def record(self, info: Mapping[str, Any]) -> None:
        """Keep a step for the replay, if one is wanted."""
        if self.replay:
            self.recorder.look(self.view, info)

    def keep_replay(self) -> None:
        """Write the page of the present drive, if it has begun."""
        if len(self.recorder.frames) < 2:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        title = self.view.title.partition(", step")[0]
        page = self.folder / f"{NOT_IN_NAMES.sub('-', title).strip('-')}-{self.round}.html"
        write_page(self.recorder.run(title, self.result), page)
        echo(f"replay: {page}")

    def frame(self) -> Bytes:
        """World and belief, and below them the keys, uint8 (height, width, 3)."""
        self.changed = False
        both = self.screen.frame(self.view, hide_world=self.hidden)
        return np.vstack([both, key_strip(both.shape[1], KEYS, self.message)])

    @property
    def result(self) -> str:
        """The figures of the drive in a line."""
        return ", ".join([self.view.title, *(f"{name} {value}" for name, value in summary(self.view.metrics))])
