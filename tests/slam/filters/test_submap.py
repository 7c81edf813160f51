"""A filter that works on a submap against the same filter without one, through the same random life."""

from typing import Any

import numpy as np
import pytest

from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import RightInvariantEkf, SubmapEkf
from mecp_env.slam.filters.submap import near_any
from mecp_env.slam.protocols import FilterError, FullFilterWarning
from tests.slam.filters.conftest import Life

MARKS = np.array([[10.0, 0.0], [10.0, 1.5]])  # of a pose, as seen from it
STEPS = ("predict", "update", "update", "mark", "register", "slip", "augment")
RARE = ("merge", "remove", "pin", "loosen", "shift", "copied")


class Ordeal(Life):
    """Also marks of past poses, which are seen sharply."""

    def __init__(self, seed: int) -> None:
        config = FilterConfig(submap=12)
        super().__init__(RightInvariantEkf(config), SubmapEkf(config), seed=seed)
        self.marks = list[Any]()
        self.augment()
        for step in range(500):
            self.live(self.rng.choice(RARE if step % 9 == 8 else STEPS))

    def mark(self) -> None:
        """Four poses have marks at once, with numbers below those of landmarks."""
        self.marks.append(np.array([-2, -3]) if not self.marks else self.marks[-1] - 2)
        self.each("augment", MARKS, np.eye(4) * 1e-7, self.marks[-1])
        if len(self.marks) > 4:
            self.each("remove", self.marks.pop(0))

    def register(self) -> None:
        for ids in self.marks[-1:]:
            self.each("update", *self.look(ids, 5e-3), ids)


@pytest.fixture(scope="module", params=[1, 3])
def ordeal(request: pytest.FixtureRequest) -> Ordeal:
    """The submap was taken anew several times."""
    made = Ordeal(request.param)
    assert made.filters[1].rest is not None
    assert len(made.filters[1].slot_ids) < len(made.filters[0].slot_ids)
    return made


def test_no_digits_are_lost_by_whatever_happens(ordeal: Ordeal) -> None:
    """A covariance in terms of bare numbers lost so many that the filter ended after 16,929 steps in `50015848`."""
    whole, divided = ordeal.each("copy")
    assert set(whole.belief().ids) == set(divided.belief().ids)
    assert min(whole.belief().ids) >= 0  # marks are no landmarks
    divided.synchronise()
    assert set(divided.slot_ids.tolist()) == set(whole.slot_ids.tolist())
    for expected, found in zip(whole.marginal(whole.slot_ids), divided.marginal(whole.slot_ids), strict=True):
        assert np.abs(found - expected).max() < 1e-10


def test_what_is_asked_of_landmarks_at_rest_is_exact(ordeal: Ordeal) -> None:
    rest = ordeal.filters[1].rest
    ids = np.concatenate((rest.slot_ids[rest.at_work][:2], rest.belief.ids[rest.is_at_rest][:3]))
    for of_whole, of_divided in zip(*ordeal.each("marginal", ids), strict=True):
        assert np.abs(of_whole - of_divided).max() < 1e-9
    z, R = ordeal.look(ids)
    for of_whole, of_divided in zip(*ordeal.each("innovation", z, R, ids), strict=True):
        assert np.abs(of_whole - of_divided).max() < 1e-8
    assert np.isclose(*ordeal.each("joint_nis", z, R, ids), rtol=1e-6)
    assert np.isclose(*ordeal.each("mean_of_gaussians_nis", z, R, ids), rtol=1e-6)


def test_every_pair_inside_a_gate_is_found(ordeal: Ordeal) -> None:
    ids = ordeal.filters[0].ids
    z, _ = ordeal.look(ids)
    blocks = np.broadcast_to(np.diag([0.05, 0.01]) ** 2, (len(z), 2, 2))
    expected, found = ordeal.each("individual_nis", z, blocks, ids)
    inside = expected < 20.0
    assert inside.sum() >= len(z) - 2
    assert np.allclose(found[inside], expected[inside], rtol=1e-6)
    assert (found[~inside] > 19.9).all()


def test_the_belief_is_exact_for_landmarks_in_the_submap(ordeal: Ordeal) -> None:
    expected, shown = ordeal.each("belief")
    assert np.array_equal(shown.ids, expected.ids)
    at_work = np.isin(shown.ids, ordeal.filters[1].slot_ids)
    assert at_work.any()
    assert np.abs(shown.p_map - expected.p_map)[at_work].max() < 1e-9
    assert np.abs(shown.covs - expected.covs)[at_work].max() < 1e-9
    assert np.abs(shown.T_map_robot - expected.T_map_robot).max() < 1e-9


def test_unknown_ids_are_refused_and_the_map_may_be_full(ordeal: Ordeal) -> None:
    divided = ordeal.filters[1]
    z, R = np.array([[2.0, 0.1]]), 1e-4 * np.eye(2)
    with pytest.raises(FilterError, match="must be new"):
        divided.augment(z, R, divided.rest.belief.ids[divided.rest.is_at_rest][:1])
    for call in (divided.innovation, divided.joint_nis, divided.copy().update):
        with pytest.raises(FilterError, match="no landmarks of this filter"):
            call(z, R, np.array([10**6]))
    config = FilterConfig(submap=12, max_landmarks=100)
    life = Life(RightInvariantEkf(config), SubmapEkf(config), seed=3)
    with pytest.warns(FullFilterWarning):
        life.live(*["augment", "update"] * 60)
    assert life.filters[0].dropped == life.filters[1].dropped > 0
    assert life.filters[0].ids.tolist() == life.filters[1].ids.tolist()


def test_landmarks_that_may_be_seen_are_those_within_five_sigmas() -> None:
    rng = np.random.default_rng(6)
    p_map, seen = rng.uniform(0.0, 10.0, size=(80, 2)), rng.uniform(0.0, 10.0, size=(5, 2))
    variance, seen_variance, asked = rng.uniform(0.0, 0.02, 80), rng.uniform(0.0, 0.02, 5), rng.random(80) < 0.7
    apart = np.hypot(*(p_map[:, None] - seen).transpose(2, 0, 1))
    within = apart < 5.0 * np.sqrt(2.0 * (variance[:, None] + seen_variance))
    found = near_any(p_map, variance, asked, seen, seen_variance)
    assert np.array_equal(found, within.any(axis=1) & asked)
    assert 5 < found.sum() < asked.sum()
