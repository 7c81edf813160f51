"""A film of an episode as a GIF of bounded length and size."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Frame = NDArray[np.uint8]

COLOURS = 64
LAST_FRAME_MS = 2500


class Film:
    """Keeps evenly spaced frames of an episode whose length is not known: when full, every other one is dropped."""

    def __init__(self, most_frames: int = 160, every: int = 2) -> None:
        self.most_frames = most_frames
        self.every = every  # periods between two frames
        self.frames: list[Frame] = []

    def offer(self, period: int, draw: Callable[[], Frame]) -> None:
        """Take the picture of a period, if it is one of those that are kept; `draw` is called only then."""
        if period % self.every:
            return
        self.frames.append(draw())
        if len(self.frames) > self.most_frames:
            self.frames = self.frames[::2]
            self.every *= 2

    def save(self, path: Path, seconds: float = 16.0) -> None:
        """Write the film as a GIF that lasts about so long and repeats; the last frame stays a while."""
        pictures = [Image.fromarray(frame) for frame in self.frames]
        palette = pictures[-1].quantize(COLOURS)  # one for all: frames then differ only where something moved
        plain = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
        each = max(20, round(1000.0 * seconds / len(plain)))
        times = [each] * (len(plain) - 1) + [LAST_FRAME_MS]
        plain[0].save(path, save_all=True, append_images=plain[1:], duration=times, loop=0, optimize=True)
