"""Figures: they can be written, show what they must, and the same data give the same file."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapely

from mecp_env.render import palette, shapes
from mecp_env.render.brush import Brush
from mecp_env.render.screen import map_picture
from mecp_env.render.shapes import summary
from tests.render import scene
from tests.slam import make


def test_the_map_shows_truth_and_belief_and_is_drawn_twice_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    written, write = list[str](), Brush.text

    def noted(brush: Brush, words: str, *more: Any, **how: Any) -> float:
        written.append(words)
        return write(brush, words, *more, **how)

    monkeypatch.setattr(Brush, "text", noted)
    picture = map_picture(scene.view())
    assert {"room 0", "room 1", "rooms", "1/2", "73.1%", "2 m", "true walls", "true path"} <= set(written)
    assert picture.shape[1] == 2400
    assert np.array_equal(picture, map_picture(scene.view()))
    for colour in (palette.TRUE_WALL, palette.TRUE_PATH, palette.ESTIMATE, palette.LANDMARK, palette.DOOR):
        assert (picture == colour).all(axis=2).any(), colour
    output = scene.output()
    belief = make.belief(output.belief.T_map_robot, pose_cov=output.belief.pose_cov)
    empty = replace(output, belief=belief, map_polygons=(), graph=replace(output.graph, doors=(), candidates=()))
    assert map_picture(scene.view(slam_output=empty)).std() > 10.0
    written.clear()
    log = map_picture(scene.view(segments=np.empty((0, 2, 2)), path_world=np.empty((0, 2))))
    assert not {"true walls", "true path", "reference path"} & set(written)
    assert (log == palette.SOLID).all(axis=2).any()
    short = summary({"rooms_found": 3, "rooms": 9, "pose_error_m": 0.0204})
    assert short == [("rooms", "3/9"), ("pose error", "2.0 cm")]  # what is not known is left out


def test_the_ellipse_holds_95_percent_of_the_samples() -> None:
    cov = np.array([[0.04, 0.018], [0.018, 0.01]])
    samples = np.random.default_rng(3).multivariate_normal([1.0, 2.0], cov, 20_000)
    ring = shapely.Polygon(shapes.ellipse(np.array([1.0, 2.0]), cov))
    assert shapely.contains_xy(ring, *samples.T).mean() == pytest.approx(0.95, abs=0.01)
