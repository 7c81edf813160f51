"""The first pass of `mecp`: the pose at which most corners are landmarks, unless another is about as good."""

from __future__ import annotations

import numpy as np
import pytest

from mecp_env.slam.messages import Decision
from tests.slam.association.test_rivals import Scene

WIDE = (2.0, 2.0, 0.4)  # m, m, rad
APART = np.array([9.0, 0.0])
SHAPE = np.array([[3.0, 0.2], [1.1, 3.4], [-2.3, 1.7], [-1.2, -2.6], [2.2, -1.9]])


def moved(scene: Scene, error: tuple[float, ...], sigmas: tuple[float, ...] = WIDE) -> Scene:
    """The scene, its pose known to `sigmas` (m, m, rad) and off by `error`."""
    scene.belief.set_pose(np.array(error), np.diag(sigmas) ** 2)
    return scene


@pytest.mark.parametrize("seed", range(8))
def test_a_rough_pose_is_found_by_the_distances(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = Scene(rng, landmarks=7, spurious=1)
    match = moved(scene, tuple(rng.normal(size=3) * (1.5, 1.5, 0.3))).associated(method="mecp")
    paired = match.recognised()
    assert match.ids[paired].tolist() == scene.true[paired].tolist()
    assert len(paired) >= 6


@pytest.mark.parametrize("turn", [0.9, -0.9])
def test_faces_may_be_turned_by_what_the_heading_may_be_wrong(turn: float) -> None:
    scene = moved(Scene(np.random.default_rng(1), p_robot=SHAPE, spurious=0), (0.5, -0.5, turn), (1.0, 1.0, 0.5))
    match = scene.associated(method="mecp")
    assert match.ids.tolist() == scene.true.tolist()


def test_of_two_equal_places_none_is_chosen() -> None:
    scene = Scene(np.random.default_rng(2), p_robot=np.concatenate([SHAPE, SHAPE + APART]), spurious=0)
    near = np.isin(scene.true, range(5))
    scene.z, scene.true = scene.z[near], scene.true[near]  # one of the places is in view
    scene.R = scene.R[:10, :10]
    match = moved(scene, (4.5, 0.0, 0.0), (4.0, 4.0, 0.2)).associated(method="mecp")
    assert len(match.recognised()) == 0
    assert (match.decision == Decision.IGNORED).all()
    match = moved(scene, (-1.0, 0.0, 0.0), (0.7, 0.7, 0.2)).associated(method="mecp")
    assert match.ids.tolist() == scene.true.tolist()


def test_one_corner_is_paired_unless_another_landmark_is_as_near() -> None:
    for beside, pairs in ((4.0, 1), (0.3, 0)):
        scene = Scene(np.random.default_rng(3), p_robot=[[3.0, 0.0], [3.0, beside]], spurious=0)
        seen = scene.true == 0
        scene.z, scene.true, scene.R = scene.z[seen], scene.true[seen], scene.R[:2, :2]
        match = moved(scene, (0.1, 0.0, 0.0), (0.2, 0.2, 0.05)).associated(method="mecp")
        assert len(match.recognised()) == pairs


def test_a_reflection_is_no_pose() -> None:
    scene = Scene(np.random.default_rng(4), p_robot=SHAPE, spurious=0)
    scene.z[:, 1] *= -1.0
    match = moved(scene, (0.0, 0.0, 0.0)).associated(method="mecp", use_descriptor=False)
    assert len(match.recognised()) < 5
