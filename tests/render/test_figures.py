"""Figures: they can be written, show what they must, and the same data give the same file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from mecp_env.render import shapes
from mecp_env.render.figures import map_figure, save
from mecp_env.render.shapes import summary
from mecp_env.render.stages import stage_figures
from mecp_env.slam.messages import EdgeLabel
from tests.render import scene
from tests.slam import make


def words(figure: Figure) -> str:
    legends = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    return " ".join([text.get_text() for text in figure.findobj(match=lambda a: hasattr(a, "get_text"))] + legends)


def test_the_map_names_its_rooms_and_figures_and_is_written_twice_the_same(tmp_path: Path) -> None:
    figure = map_figure(scene.view())
    assert all(name in words(figure) for name in ("room 0", "room 1", "rooms 1/2", "coverage 73.1%", "2 m"))
    save(figure, tmp_path / "a.png", dpi=60)
    save(map_figure(scene.view()), tmp_path / "b.png", dpi=60)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert np.asarray(Image.open(tmp_path / "a.png")).std() > 10.0
    output = scene.output()
    belief = make.belief(output.belief.T_map_robot, pose_cov=output.belief.pose_cov)
    empty = replace(output, belief=belief, map_polygons=(), graph=replace(output.graph, doors=(), candidates=()))
    save(map_figure(scene.view(slam_output=empty)), tmp_path / "empty.png", dpi=40)
    short = summary({"rooms_found": 3, "rooms": 9, "pose_error_m": 0.0204})
    assert short == [("rooms", "3/9"), ("pose error", "2.0 cm")]  # what is not known is left out


def test_one_picture_a_stage() -> None:
    edges = np.array([[0, 0.0, 0.5, EdgeLabel.WALL], [0, 0.5, 1.0, EdgeLabel.GAP], [1, 0.0, 1.0, EdgeLabel.OPEN]])
    output = replace(scene.output(), polygons=(make.polygon([0, 1, 2], edges),), corners=scene.corners())
    figures = stage_figures(output, make.clusters([0, 300], [299, 719]))
    assert list(figures) == ["scan", "clusters", "segments", "corners", "polygon", "association"]
    assert all(figure.axes[0].lines for figure in figures.values())


def test_the_ellipse_holds_95_percent_of_the_samples() -> None:
    cov = np.array([[0.04, 0.018], [0.018, 0.01]])
    samples = np.random.default_rng(3).multivariate_normal([1.0, 2.0], cov, 20_000)
    ring = shapes.ellipse(np.array([1.0, 2.0]), cov)
    after = np.roll(ring, -1, axis=0)
    edges, to_sample = after - ring, samples[:, None] - ring
    inside = (edges[:, 0] * to_sample[..., 1] - edges[:, 1] * to_sample[..., 0] > 0).all(axis=1)
    mirrored = (edges[:, 0] * to_sample[..., 1] - edges[:, 1] * to_sample[..., 0] < 0).all(axis=1)
    assert max(inside.mean(), mirrored.mean()) == pytest.approx(0.95, abs=0.01)
