"""The benchmark `real`: a tiny part where the data are there, and what it says where they are not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks import real, real_logs
from benchmarks.common import Options, shared_data
from benchmarks.plan_scores import score_rooms
from benchmarks.worlds import explored
from mecp_env.evaluation.calibration import calibrate_log
from mecp_env.evaluation.log_run import config_for
from mecp_env.floorplans import load_plan
from mecp_env.world.layout import load_layout
from tests.floorplans import plans

HOUSE = "0a1b29dba355df2ab02630133187bfab"
needs_plans = pytest.mark.skipif(shared_data("plans") is None, reason="shared/data/plans is not beside the repository")
needs_logs = pytest.mark.skipif(shared_data("logs") is None, reason="shared/data/logs is not beside the repository")


@pytest.fixture(autouse=True)
def maps(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for module in (real, real_logs):
        monkeypatch.setattr(module, "MAPS", tmp_path)


@needs_plans
def test_a_home_is_explored_and_drawn() -> None:
    visit = real.measure((real.EXPLORED, HOUSE, 0))
    figures = {real.EXPLORED: real.summarise(real.EXPLORED, {HOUSE: [visit]})}
    assert visit["seen"]
    assert not visit["early"]
    assert figures[real.EXPLORED][HOUSE]["precision"]["value"] > 0.98
    assert "## Explorations\n\n| | 0a1b29db... |" in real.report(figures)
    (axes,) = (axes for axes in real.figure(figures).axes if axes.get_title())
    assert axes.get_title().startswith("0a1b29db...:\n116 m2, pose RMSE ")


@pytest.mark.slow
@needs_logs
def test_a_doubt_on_a_log_ends_where_known_corners_are_seen() -> None:
    """While only strong evidence ended one, the first corridor was not mapped: .39 m and 39 % localised."""
    figures = real_logs.map_log("intel_raw", 0, 250)
    assert figures["ate_m"] < 0.25
    assert figures["localised_share"] > 0.9


def test_a_door_in_a_double_wall_is_one_door() -> None:
    """Walls of KTH floors are up to 0.7 m thick: each face of a doorway was a door of its own, or none."""
    layout = load_layout("two_rooms")
    walls = layout.walls[0], layout.walls[1].model_copy(update={"thickness_m": 0.65})
    visit, env = explored(layout.model_copy(update={"walls": walls}), 0, 2000)
    assert visit["complete"]
    assert visit["doors_false"] == 0
    (door,) = env.get_wrapper_attr("view")().slam_output.graph.doors
    assert door.other_face is not None


@needs_plans
def test_rooms_of_a_labelled_plan_are_counted() -> None:
    figures = real.summarise(real.PLANS, {"50052752": [real.measure((real.PLANS, "50052752", 0))]})
    assert figures["all"]["labelled"] == 26
    assert figures["all"]["found"]["value"] > 0.9
    assert "| 50052752 | 26 |" in real.report({real.PLANS: figures})


@needs_logs
def test_a_part_of_a_log_gives_all_figures_and_raw_odometry_is_calibrated_without_the_reference() -> None:
    run = real.measure(("intel_raw", "20", 0))
    figures = {"intel_raw": real.summarise("intel_raw", {"20": [run, run]})}
    assert figures["intel_raw"]["scans"] <= 20
    assert figures["intel_raw"]["ate_m"]["value"] < 0.3
    assert real.figure(figures).axes[0].get_title().startswith("intel_raw, ")
    assert "polygon share" in real.report(figures)
    log, calibration = real_logs.calibrated("intel_raw")
    found = calibrate_log(replace(log, T_ref_robot=None), config_for(log), {}, {})
    assert found.sensor.x_m == pytest.approx(0.095, abs=0.02)  # 0.08 against the reference path
    assert calibration is not None
    assert calibration.sensor.x_m == found.sensor.x_m


def test_without_data_the_sets_are_skipped_and_the_page_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(real, "shared_data", lambda kind: None)
    monkeypatch.setattr(real, "plans", dict)
    figures = real.run(Options(sets=("plans", "explored:1", "fr079")))
    assert set(figures) == {"skipped"}
    assert "Skipped: fr079, no shared/data/logs/fr079.npz." in real.report(figures)
    assert set(real.QUICK) <= set(real.SETS)


def labels_of_two_rooms() -> np.ndarray[tuple[int, int], np.dtype[np.int32]]:
    labels = np.zeros(plans.two_rooms_picture().shape, np.int32)
    labels[12:112, 12:92], labels[12:112, 94:174] = 1, 2
    return labels


def test_rooms_are_found_where_they_overlap_a_label(tmp_path: Path) -> None:
    layout = load_plan(plans.map_pair(tmp_path, plans.two_rooms_picture()))
    labels = labels_of_two_rooms()
    assert score_rooms(layout, labels, plans.RESOLUTION_M) == {"labelled": 2, "found": 2, "imported": 2, "false": 0}
    split = np.where((labels == 1) & (np.indices(labels.shape)[0] < 60), 3, labels)
    assert score_rooms(layout, split, plans.RESOLUTION_M) == {"labelled": 3, "found": 2, "imported": 2, "false": 0}
    merged = np.minimum(labels, 1)
    assert score_rooms(layout, merged, plans.RESOLUTION_M) == {"labelled": 1, "found": 0, "imported": 2, "false": 2}
    small = np.where(labels == 1, labels, 0)
    small[12:40, 94:122] = 2  # 1.96 m2
    assert score_rooms(layout, small, plans.RESOLUTION_M) == {"labelled": 1, "found": 1, "imported": 2, "false": 1}


@pytest.mark.slow
@plans.needs_real
def test_rooms_of_the_kth_plans() -> None:
    scores = []
    for path in sorted(plans.real("kth").glob("*.yaml")):
        labels = np.asarray(Image.open(path.with_suffix(".rooms.png"))).astype(np.int32)
        scores.append(score_rooms(load_plan(path), labels, plans.RESOLUTION_M))
    labelled, found, imported, false = np.sum([list(score.values()) for score in scores], axis=0)
    assert found >= 0.9 * labelled
    assert false <= 0.05 * imported
