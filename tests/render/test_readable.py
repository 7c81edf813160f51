"""Figures are readable: letters large enough on a page, contrast, units, legends of what is drawn, shapes with hues."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

from benchmarks.common import estimate
from benchmarks.plots import MOST_ACROSS, Panel, line_panels
from mecp_env.floorplans.plan_view import floor_plan
from mecp_env.render import palette
from mecp_env.render.brush import Brush
from mecp_env.render.figures import curves_figure, drawn
from mecp_env.render.plan_figures import plans_figure
from mecp_env.render.stages import KINDS, MARKS, stage_figures
from mecp_env.slam.messages import EdgeLabel
from mecp_env.world.config import GeneratorSpec
from mecp_env.world.generator import generate
from mecp_env.world.layout import load_layout
from tests.render import scene
from tests.render.contrast import contrast
from tests.slam import make

ROOT = Path(__file__).parents[2]
PAGE_PX, LEAST_PX = 736.0, 8.0  # width of the text of a page of the site
LEAST_CONTRAST = 4.5


def smallest_px(figure: Figure) -> float:
    """The height of the smallest letters of a figure that a page shows, px."""
    shown = min(PAGE_PX / figure.get_figwidth(), 96.0)  # px per inch
    sizes = [text.get_fontsize() for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]
    return shown * min(sizes) / 72.0


def legend_of(figure: Figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


@pytest.fixture(scope="module")
def stages() -> dict[str, Figure]:
    triangle = make.polygon([0, 1, 2], [[0, 0.0, 0.5, EdgeLabel.WALL], [1, 0.0, 1.0, EdgeLabel.OPEN]])
    output = replace(scene.output(), polygons=(triangle, triangle), corners=scene.corners())
    return stage_figures(output, make.clusters([0, 300], [299, 719]))


@pytest.mark.parametrize("count", [1, 6])
def test_letters_of_plans_are_large_enough_on_a_page(count: int) -> None:
    plans = [floor_plan(generate(GeneratorSpec.preset("hard"), seed)) for seed in range(count)]
    figure = plans_figure(plans)
    assert smallest_px(figure) >= LEAST_PX
    names = {text.get_text() for text in figure.findobj(Text)}
    rooms = {room.name for plan in plans for room in plan.rooms}
    assert len(names & rooms) > 0.5 * len(rooms)


def test_names_of_rooms_have_contrast() -> None:
    for colour in palette.ROOMS:
        light, ink = palette.mix(colour, palette.FREE, 0.74), palette.mix(colour, palette.INK, 0.6)
        assert contrast(ink, light) >= LEAST_CONTRAST
    for ink in (palette.INK, palette.MUTED):
        for ground in (palette.PAPER, palette.FREE):
            assert contrast(ink, ground) >= LEAST_CONTRAST


def test_the_legend_of_plans_has_what_they_have() -> None:
    bare, furnished = floor_plan(load_layout("two_rooms")), floor_plan(load_layout("furnished"))
    assert legend_of(plans_figure([furnished])) == ["door", "obstacle", "first start", "other start"]
    assert legend_of(plans_figure([replace(bare, obstacles=(), doors=(), starts=bare.starts[:1])])) == ["first start"]


def test_letters_of_other_figures_are_large_enough_and_series_differ_in_shape_as_well_as_in_hue(stages) -> None:
    panel = Panel(["a", "b"], {str(k): [estimate([1.0, 2.0])] * 2 for k in range(6)})
    panels = line_panels({str(k): panel for k in range(2 * MOST_ACROSS - 1)}, "error, m")
    for name, figure in {**stages, "panels": panels}.items():
        figure.draw_without_rendering()
        assert smallest_px(figure) >= LEAST_PX, name
    lines = [line for line in panels.axes[0].get_lines() if line.get_marker() not in ("_", "|")]
    assert len({(line.get_marker(), line.get_linestyle()) for line in lines}) == 6
    assert len(set(palette.SERIES)) == len(palette.MARKERS)
    for marks in (MARKS.values(), [mark for mark, _ in KINDS.values()], palette.MARKERS):
        assert len(set(marks)) == len(marks)


def test_axes_have_units_and_curves_are_those_that_a_run_has(stages: dict[str, Figure]) -> None:
    moment = {"pose_error_m": 0.01, "sigma3_m": 0.03, "nees": 3.0, "coverage": 0.1}
    curves = curves_figure("a run", 0.4, [moment | {"landmarks": k} for k in range(9)])
    for axes in curves.axes:
        assert re.search(r", (cm|%|count|no unit)$", axes.get_ylabel()), axes.get_ylabel()
        assert axes.get_xlabel() == "time, s"
    assert {int(tick) for tick in curves.axes[3].get_yticks()} == set(curves.axes[3].get_yticks())
    assert list(stages) == ["scan", "clusters", "segments", "corners", "polygon", "association"]
    for figure in stages.values():
        assert figure.axes[0].lines
        assert (figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()) == ("x, m", "y, m")
        assert legend_of(figure) == drawn(figure.axes[0])["labels"]
    assert {"wall", "open", "polygon"} <= set(legend_of(stages["polygon"]))
    assert "gap" not in legend_of(stages["polygon"])
    log = curves_figure("a log without truth", 0.4, [{"sigma3_m": 0.03, "landmarks": k} for k in range(9)])
    legends = [axes.get_legend() for axes in log.axes]
    named = [[text.get_text() for text in legend.get_texts()] if legend else [] for legend in legends]
    assert named == [["3 sigma"], [], [], ["landmarks"]]


def test_polygons_of_a_scan_that_overlap_are_no_darker(stages: dict[str, Figure]) -> None:
    """The scene has one polygon twice."""
    canvas = FigureCanvasAgg(stages["polygon"])
    canvas.draw()
    light = 255.0 * np.array(to_rgb(palette.unit(palette.mix(palette.ROOMS[0], palette.FREE, 0.85))))
    shown = np.abs(np.asarray(canvas.buffer_rgba(), float)[:, :, :3] - light).max(axis=2) < 1.5
    assert shown.mean() > 0.01


def test_a_label_is_readable_on_a_wall_and_on_a_floor() -> None:
    for ground in (palette.SOLID, palette.UNSEEN, *palette.ROOMS):
        brush = Brush((120, 40), ground)
        brush.label("room 7", (60.0, 20.0), 18)
        shown = brush.image().reshape(-1, 3).astype(float)
        assert (np.abs(shown - palette.INK).max(axis=1) < 25).any()
        assert (np.abs(shown - palette.PAPER).max(axis=1) < 25).any()


def test_pictures_of_the_docs_are_sharp_and_small() -> None:
    """Twice the pixels of the page, within 2 MB."""
    names = ["plans", "worlds", "policies", "first", "replay", *(f"one-scan/{k}-*" for k in range(1, 7))]
    for name in names:
        (path,) = (ROOT / "docs/images").glob(f"{name}.png")
        with Image.open(path) as picture:
            assert picture.width >= 2 * PAGE_PX, path
        assert path.stat().st_size < 500_000
