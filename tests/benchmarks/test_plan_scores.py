"""Scores of imported plans against labels; and those of the real plans with labels."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.plan_scores import RoomScore, score_rooms
from mecp_env.floorplans import load_plan
from tests.floorplans import plans

RESOLUTION_M = plans.RESOLUTION_M


def labels_of_two_rooms() -> np.ndarray[tuple[int, int], np.dtype[np.int32]]:
    labels = np.zeros(plans.two_rooms_picture().shape, np.int32)
    labels[12:112, 12:92], labels[12:112, 94:174] = 1, 2
    return labels


def test_rooms_are_found_where_they_overlap_a_label(tmp_path: Path) -> None:
    layout = load_plan(plans.map_pair(tmp_path, plans.two_rooms_picture()))
    labels = labels_of_two_rooms()
    assert score_rooms(layout, labels, RESOLUTION_M) == RoomScore(labelled=2, found=2, imported=2, false=0)
    split = np.where((labels == 1) & (np.indices(labels.shape)[0] < 60), 3, labels)
    assert score_rooms(layout, split, RESOLUTION_M) == RoomScore(labelled=3, found=2, imported=2, false=0)
    merged = np.minimum(labels, 1)
    assert score_rooms(layout, merged, RESOLUTION_M) == RoomScore(labelled=1, found=0, imported=2, false=2)
    small = np.where(labels == 1, labels, 0)
    small[12:40, 94:122] = 2  # 1.96 m2
    assert score_rooms(layout, small, RESOLUTION_M) == RoomScore(labelled=1, found=1, imported=2, false=1)


@pytest.mark.slow
@plans.needs_real
def test_rooms_of_the_kth_plans() -> None:
    scores = []
    for path in sorted(plans.real("kth").glob("*.yaml")):
        labels = np.asarray(Image.open(path.with_suffix(".rooms.png"))).astype(np.int32)
        scores.append(score_rooms(load_plan(path), labels, RESOLUTION_M))
    labelled, found, imported, false = np.sum([(s.labelled, s.found, s.imported, s.false) for s in scores], axis=0)
    assert found >= 0.9 * labelled
    assert false <= 0.05 * imported
