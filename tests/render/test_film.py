"""The film: bounded length, evenly spaced frames, drawn only when kept, and a GIF that reads back."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mecp_env.render.screen import LAST_FRAME_MS, Film


def frame(step: int) -> np.ndarray:
    picture = np.full((40, 60, 3), 255, np.uint8)
    picture[10:20, step % 50 : step % 50 + 10] = (200, 30, 40)
    return picture


@pytest.mark.parametrize("steps", [3, 41, 1000])
def test_a_film_has_bounded_length_and_even_spacing(steps: int) -> None:
    film, drawn = Film(most_frames=20, every=2), []
    for step in range(steps):
        film.offer(step, lambda step=step: drawn.append(step) or np.full((1, 1, 3), step % 256, np.uint8))
    assert 1 < len(film) <= 20
    assert set(np.diff([int(film[row][0, 0, 0]) for row in range(len(film))]) % 256) == {film.every % 256}
    assert len(drawn) < 20 * 2 + 20 * np.log2(max(steps, 2))


def test_the_gif_repeats_and_holds_its_last_frame(tmp_path: Path) -> None:
    film = Film()
    for step in range(60):
        film.offer(step, lambda step=step: frame(step))
    film.save(tmp_path / "run.gif", seconds=3.0)
    with Image.open(tmp_path / "run.gif") as gif:
        assert gif.n_frames == 30
        assert gif.info["loop"] == 0
        gif.seek(29)
        assert gif.info["duration"] == LAST_FRAME_MS
        shown = np.asarray(gif.convert("RGB")).astype(int)
    assert np.abs(shown - frame(58)).max() < 12
