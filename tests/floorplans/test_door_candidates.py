"""Candidates for doorways: between which faces they are sought, whatever is tested first and however many at once."""

import numpy as np
import pytest
import shapely
from shapely.geometry import Polygon

from mecp_env.core.errors import LayoutError
from mecp_env.floorplans import door_candidates
from mecp_env.floorplans.door_candidates import crossings, wall_faces
from mecp_env.world.layout import load_layout
from mecp_env.world.outline import build_outline

WIDTHS_M = (0.5, 1.9)


@pytest.fixture(scope="module")
def floor() -> Polygon:
    return build_outline(load_layout("furnished")).free_area


def found(floor: Polygon) -> list[np.ndarray]:
    return [np.stack([each.middle, each.along]) for each in crossings(floor, wall_faces(floor), (0.0,), WIDTHS_M)]


def test_no_bit_depends_on_how_many_faces_are_looked_at_at_once(
    floor: Polygon, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_once = found(floor)
    monkeypatch.setattr(door_candidates, "CHUNK", 7)
    assert len(at_once) > 10
    assert np.array_equal(at_once, found(floor))


def test_pairs_are_those_of_the_exact_distance(floor: Polygon) -> None:
    faces = wall_faces(floor)
    tree = shapely.STRtree(shapely.linestrings(faces))
    i, j = tree.query(tree.geometries, predicate="dwithin", distance=WIDTHS_M[1])
    pairs = {(a, b) for a, b in zip(i.tolist(), j.tolist(), strict=True) if a < b}
    near = set(zip(*(side.tolist() for side in door_candidates._near(tree, faces, WIDTHS_M[1])), strict=True))
    a, b = np.array(sorted(pairs)).T
    facing = door_candidates._is_in_front(faces[a], faces[b]) & door_candidates._is_in_front(faces[b], faces[a])
    assert near == set(zip(a[facing].tolist(), b[facing].tolist(), strict=True))


def test_far_too_many_pairs_are_refused_by_their_number(floor: Polygon, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(door_candidates, "MAX_PAIRS", 500)
    with pytest.raises(LayoutError, match=r"the floor has \d+ pairs of edges within 1\.9 m, at most 500"):
        found(floor)
