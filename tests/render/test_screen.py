"""Frames: shape, type, no display access, and the visible content. Films: of bounded length, evenly spaced."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pygame
import pytest
from PIL import Image

from mecp_env.core.se2 import compose, to_robot
from mecp_env.render import palette, shapes
from mecp_env.render.brush import Box, Camera
from mecp_env.render.screen import LAST_FRAME_MS, SMALL_HEADER, Film, Screen, grid_picture, thumbnail
from mecp_env.render.shapes import loops, signed_area
from mecp_env.render.window import Window
from mecp_env.slam.messages import Cell
from tests.processes import run_python
from tests.render import scene
from tests.slam import make


def share(frame: np.ndarray, colour: palette.RGB) -> float:
    """Share of the picture's pixels that have just this colour."""
    return float((frame == colour).all(axis=2).mean())


def test_a_frame_has_the_configured_size_and_shows_world_and_belief() -> None:
    screen = Screen(800, 400)
    frame = screen.frame(scene.view())
    assert (frame.shape, frame.dtype, frame.flags.c_contiguous) == ((400, 800, 3), np.uint8, True)
    left, right = frame[:, :400], frame[:, 400:]
    assert share(left, palette.FREE) > 0.05
    assert share(left, palette.SOLID) > 0.01
    assert share(right, palette.UNSEEN) > 0.2
    assert share(right, palette.ESTIMATE) > 0.001
    assert np.array_equal(frame, screen.frame(scene.view()))
    assert not np.array_equal(frame, screen.frame(scene.view(T_world_robot=np.array([1.5, 3.0, 2.0]))))
    empty = replace(scene.output(), belief=make.belief(scene.output().belief.T_map_robot), map_polygons=())
    assert screen.frame(scene.view(slam_output=empty, p_goals=np.empty((0, 2)), metrics={})).any()


def test_frames_need_no_display_and_no_window() -> None:
    code = (
        "import os; os.environ.pop('SDL_VIDEODRIVER', None); os.environ.pop('DISPLAY', None)\n"
        "from mecp_env.render.screen import Screen\nfrom tests.render.scene import view\nimport pygame\n"
        "Screen().frame(view()); assert not pygame.display.get_init(); print('drawn')"
    )
    assert run_python(code) == "drawn\n"


def test_the_window_shows_frames_and_survives_being_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    window, frame = Window("test"), Screen().frame(scene.view())
    window.show(frame)
    assert pygame.display.get_init()
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    window.show(frame)
    assert window.closed
    assert not pygame.display.get_init()
    window.show(frame)
    window.close()


def test_faces_are_chained_to_rings_around_solid_and_free_space() -> None:
    outer, inner = loops(scene.faces())
    assert signed_area(outer) == pytest.approx(-9.3 * 4.2)
    assert signed_area(inner) == pytest.approx(5 * 4 + 0.1 * 0.9 + 4 * 4)


def test_the_grid_lies_where_the_world_is_with_rows_upwards() -> None:
    view, box = scene.view(), Box(0, 0, 300, 200)
    camera = Camera.fit(view.bounds, box)
    picture = grid_picture(view.slam_output.grid, view.T_world_map, camera, box)

    def colour_at(x: float, y: float) -> tuple[int, ...]:
        across, down = camera.pixels(np.array([[x, y]]))[0].astype(int)
        return tuple(picture[down, across].tolist())

    assert colour_at(1.0, 3.5) == palette.mix(palette.FREE, palette.room_colour(0), 0.2)
    assert colour_at(6.5, 0.5) == palette.mix(palette.FREE, palette.room_colour(1), 0.2)
    assert colour_at(8.5, 2.0) == palette.UNSEEN
    assert (view.slam_output.grid.label == Cell.DOOR).any()


def test_a_thumbnail_shows_the_belief_below_two_lines_of_text() -> None:
    picture = thumbnail(scene.view(), (320, 260), "nearest", "12 s    3 m    40% seen")
    assert (picture.shape, picture.dtype) == ((260, 320, 3), np.uint8)
    text, belief = picture[:SMALL_HEADER], picture[SMALL_HEADER:]
    assert share(text, palette.PAPER) > 0.7
    assert 0.005 < np.mean(text < 200) < 0.3
    assert share(belief, palette.UNSEEN) > 0.1
    assert share(belief, palette.ESTIMATE) > 0.0005


def test_the_fan_of_a_mounted_laser_with_half_a_view_starts_at_the_laser() -> None:
    view = scene.view()
    beams, T = view.slam_output.beams, np.array([0.1, 0.2, 0.5])
    columns = ("ranges", "bearings", "hit", "count", "raw_ranges", "raw_bearings")
    half = replace(beams, **{name: getattr(beams, name)[180:540] for name in columns})
    output = replace(view.slam_output, beams=half, T_robot_laser=T)
    fan = to_robot(compose(view.T_world_robot, T), shapes.beam_fan(output, view.T_world_robot))
    assert fan.shape == (361, 2)
    assert fan[-1] == pytest.approx(np.zeros(2))
    assert np.hypot(*fan[:-1].T) == pytest.approx(half.ranges)
    assert fan[:, 0].min() > -0.01
    around = replace(view.slam_output, T_robot_laser=T)
    assert len(shapes.beam_fan(around, view.T_world_robot)) == 720


def moving(step: int) -> np.ndarray:
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
        film.offer(step, lambda step=step: moving(step))
    film.save(tmp_path / "run.gif", seconds=3.0)
    with Image.open(tmp_path / "run.gif") as gif:
        assert gif.n_frames == 30
        assert gif.info["loop"] == 0
        gif.seek(29)
        assert gif.info["duration"] == LAST_FRAME_MS
        shown = np.asarray(gif.convert("RGB")).astype(int)
    assert np.abs(shown - moving(58)).max() < 12
