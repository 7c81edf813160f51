"""A film of an episode as a GIF of bounded length and size."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from mecp_env.core.carriers import Bytes
from mecp_env.render import palette

COLOURS = 96
SMALL = (palette.HIT, palette.LANDMARK, palette.GOAL, palette.DOOR, palette.ESTIMATE, palette.TRUTH, palette.INK)
LAST_FRAME_MS = 2500


class Film:
    """Keeps evenly spaced frames of an episode whose length is not known: when full, every other one is dropped."""

    def __init__(self, most_frames: int = 160, every: int = 2) -> None:
        self.most_frames = most_frames
        self.every = every  # steps between two frames
        self.frames: list[Bytes] = []

    def offer(self, step: int, draw: Callable[[], Bytes]) -> None:
        """Take the picture of a step, if it is one of those that are kept; `draw` is called only then."""
        if step % self.every:
            return
        self.frames.append(draw())
        if len(self.frames) > self.most_frames:
            self.frames = self.frames[::2]
            self.every *= 2

    def save(self, path: Path, seconds: float = 16.0) -> None:
        """Write the film as a GIF that lasts about so long and repeats; the last frame stays a while."""
        pictures = [Image.fromarray(frame) for frame in self.frames]
        colours = _palette(self.frames)  # one for all: frames then differ only where something moved
        plain = [picture.quantize(palette=colours, dither=Image.Dither.NONE) for picture in pictures]
        each = max(20, round(1000.0 * seconds / len(plain)))
        times = [each] * (len(plain) - 1) + [LAST_FRAME_MS]
        plain[0].save(path, save_all=True, append_images=plain[1:], duration=times, loop=0, optimize=True)


def _palette(frames: list[Bytes]) -> Image.Image:
    """A picture with the colours of some frames spread over the film, and patches of what is small but must be seen."""
    count = min(len(frames), 5)
    some = [frames[i] for i in np.linspace(0, len(frames) - 1, count).astype(int)]
    wide = np.repeat(np.array(SMALL, np.uint8)[None], max(frames[0].shape[0] // 4, 1), axis=0)
    patches = np.repeat(wide, -(-frames[0].shape[1] // len(SMALL)), axis=1)[:, : frames[0].shape[1]]
    return Image.fromarray(np.vstack([*some, patches])).quantize(COLOURS)
