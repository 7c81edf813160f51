"""A drive by hand: which key does what, and what a moment of it looks like. Opens no window."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pygame
from numpy.typing import NDArray
from PIL import Image as Pictures

from mecp_env.core.errors import MecpError
from mecp_env.env import MecpEnv
from mecp_env.render.keys import KeyHelp, key_strip
from mecp_env.render.screen import Screen
from mecp_env.render.text import summary

Image = NDArray[np.uint8]

FORWARD, BACK = {pygame.K_UP, pygame.K_w}, {pygame.K_DOWN, pygame.K_s}
LEFT, RIGHT = {pygame.K_LEFT, pygame.K_a}, {pygame.K_RIGHT, pygame.K_d}
SLOW, WAIT = {pygame.K_LSHIFT, pygame.K_RSHIFT}, {pygame.K_SPACE}
STEPPING = FORWARD | BACK | LEFT | RIGHT | WAIT
QUIT = {pygame.K_ESCAPE, pygame.K_q}
KEYS: tuple[KeyHelp, ...] = (
    (("up", "down", "left", "right"), "or"),
    (("W", "A", "S", "D"), "drive"),
    (("Shift",), "slowly"),
    (("Space",), "wait and scan"),
    (("H",), "hide the world"),
    (("P",), "keep a picture"),
    (("R",), "again"),
    (("N",), "next"),
    (("Esc",), "quit"),
)
TURN, SLOWLY = 0.5, 0.35  # shares of the largest turn rate, and of both when slow
AT_REST_M = 1e-3  # the robot has stopped when it moved, or turned (rad), less than this in a step
NOT_IN_NAMES = re.compile(r"[^\w]+")  # of files: the building's own name may hold anything
HELP = "Time stands still while no key is held. Find every room and door; green rings are what is left to see."


class Game:
    """One drive after the other, each begun with `make(round)`: the environment and the seed of that round."""

    def __init__(self, make: Callable[[int], tuple[MecpEnv, int]], folder: Path) -> None:
        self.make, self.folder = make, folder
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
        self.env = env
        self.view, self.moving, self.over = self.env.view(), False, False
        self.message, self.changed = HELP, True

    def begin_or_tell(self) -> None:
        """Start the present round; where its building cannot be used, the last one goes on and the window says why."""
        try:
            self.begin()
        except MecpError as error:
            self.message = f"Round {self.round + 1} cannot begin, N takes the next: {error}"

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
            self.begin_or_tell()
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
        self.moving = bool(np.abs(self.view.T_world_robot - before).max() > AT_REST_M)
        self.over = terminated or truncated
        self.changed = True
        if self.over:
            why = "Explored: nothing is left to see" if terminated else "The map is lost"
            why = why if terminated or info["diverged"] else "Time is up"
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

    def frame(self) -> Image:
        """World and belief, and below them the keys, uint8 (height, width, 3)."""
        self.changed = False
        both = self.screen.frame(self.view, hide_world=self.hidden)
        return np.vstack([both, key_strip(both.shape[1], KEYS, self.message)])

    @property
    def result(self) -> str:
        """The figures of the drive in a line."""
        return ", ".join([self.view.title, *(f"{name} {value}" for name, value in summary(self.view.metrics))])
